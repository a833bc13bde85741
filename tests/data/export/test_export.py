"""Exports as files: what is written, what is refused. The real libraries: tests/export_envs."""

import io
import json
from dataclasses import asdict, replace
from pathlib import Path

import gymnasium
import numpy as np
import pandas as pd
import PIL.Image
import pyarrow.parquet as pq
import pytest
import torch
from gymnasium.envs.registration import EnvSpec
from pyarrow import ipc

from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.export.lerobot import writer as lerobot
from racines_data.export.registry import exporter_names, load_exporter
from racines_data.phantom.config import PHANTOM_VERSION, BlockConfig, PhantomConfig
from racines_data.store.sweeps import read_sweeps
from racines_envs.recordings.minari import env_spec, judge_steps
from racines_envs.worlds.making import make_core
from tests.conftest import command
from tests.data.fake_source import FakeConfig, FakeSource

OURS = ("lerobot", "minari")


class MovingSource(FakeSource):
    """A source with a commanded velocity; unknown in the first frame of each sweep."""

    def produce(self, unit):
        made = super().produce(unit)
        controls = np.random.default_rng(len(unit.id)).normal(size=made.controls.shape)
        controls[0] = np.nan
        return replace(made, controls=controls.astype(np.float32))


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("moving") / "racines"
    build(MovingSource(FakeConfig()), root, DataConfig(workers=1))
    return root


def test_sweeps_are_the_trajectories_in_the_datasets_order(moving: Path):
    manifest = json.loads((moving / "manifest.json").read_text())
    paths = manifest["configs"]["frames"]
    rows = [
        row
        for split in paths
        for path in paths[split]
        for row in pq.read_table(moving / path).to_pylist()
    ]
    sweeps = list(read_sweeps(moving))
    assert len(sweeps) == len({sweep.id for sweep in sweeps}) == 20
    told = [row for sweep in sweeps for row in sweep.table.to_pylist()]
    assert [(r["trajectory"], r["frame"]) for r in told] == [
        (r["trajectory"], r["frame"]) for r in rows
    ]
    assert [sweep.pngs() for sweep in sweeps] == [
        [r["image"]["bytes"] for r in rows if r["trajectory"] == sweep.id] for sweep in sweeps
    ]


def test_a_trajectory_that_goes_on_in_the_next_shard_is_whole(tmp_path: Path):
    build(FakeSource(FakeConfig(trajectories=5)), tmp_path / "d", DataConfig(workers=1, shards=60))
    assert sorted(len(sweep) for sweep in read_sweeps(tmp_path / "d")) == [40] * 5


def test_limits_and_splits_choose_sweeps(moving: Path):
    whole = list(read_sweeps(moving))
    some = list(read_sweeps(moving, limit=25))
    assert [len(sweep) for sweep in some] == [10, 10, 5]
    assert [sweep.id for sweep in some] == [sweep.id for sweep in whole[:3]]
    tested = list(read_sweeps(moving, "test"))
    assert {sweep.split for sweep in tested} == {"test"} and sum(map(len, tested)) == 50
    with pytest.raises(RacinesError, match="unknown split 'dev'"):
        list(read_sweeps(moving, "dev"))
    with pytest.raises(RacinesError, match="limit 0"):
        list(read_sweeps(moving, limit=0))


@pytest.mark.parametrize("name", OURS)
def test_an_export_is_whole_or_absent(name: str, moving: Path, tmp_path: Path, monkeypatch):
    out = tmp_path / "out"
    (tmp_path / ".out.part").mkdir()  # left by one that was killed
    (tmp_path / ".out.part" / "junk").touch()
    made = load_exporter(name)(moving, out, limit=30)
    assert made["frames"] == 30 and made["trajectories"] == 3 and made["format"] == name
    assert not (out / "junk").exists() and not (tmp_path / ".out.part").exists()
    assert made["notes"]  # the frames without a commanded velocity are counted
    with pytest.raises(RacinesError, match="exists; name a new folder"):
        load_exporter(name)(moving, out)
    with pytest.raises(RacinesError, match="no dataset here"):
        load_exporter(name)(tmp_path / "none", tmp_path / "other")
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize("name", OURS)
def test_data_without_a_commanded_velocity_are_refused(name: str, built: Path, tmp_path: Path):
    with pytest.raises(RacinesError, match="no commanded velocity"):
        load_exporter(name)(built, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", OURS)
def test_equal_exports_have_equal_bytes(name: str, moving: Path, tmp_path: Path):
    trees = []
    for folder in (tmp_path / "one", tmp_path / "two"):
        load_exporter(name)(moving, folder)
        files = (path for path in folder.rglob("*") if path.is_file())
        trees.append({path.relative_to(folder): path.read_bytes() for path in files})
    assert trees[0] == trees[1]


def test_lerobot_keeps_pngs_byte_for_byte(moving: Path, tmp_path: Path):
    load_exporter("lerobot")(moving, tmp_path / "out")
    table = pq.read_table(tmp_path / "out" / "data/chunk-000/file-000.parquet")
    pngs = [png for sweep in read_sweeps(moving) for png in sweep.pngs()]
    assert [row["bytes"] for row in table[lerobot.IMAGE].to_pylist()] == pngs
    assert table["index"].to_pylist() == [*range(200)]


def test_lerobot_pictures_of_three_channels_are_the_same_gray(moving: Path, tmp_path: Path):
    load_exporter("lerobot")(moving, tmp_path / "gray", limit=30)
    load_exporter("lerobot-rgb")(moving, tmp_path / "rgb", limit=30)
    gray, rgb = (
        [np.asarray(PIL.Image.open(io.BytesIO(row["bytes"]))) for row in
         pq.read_table(tmp_path / name / "data")[lerobot.IMAGE].to_pylist()]
        for name in ("gray", "rgb")
    )  # fmt: skip
    assert all(np.array_equal(three, np.stack([one] * 3, -1))
               for one, three in zip(gray, rgb, strict=True))  # fmt: skip
    told = [
        json.loads((tmp_path / name / "meta/info.json").read_text()) for name in ("gray", "rgb")
    ]
    assert [each["features"][lerobot.IMAGE]["shape"][2] for each in told] == [1, 3]
    means = [json.loads((tmp_path / name / "meta/stats.json").read_text())[lerobot.IMAGE]["mean"]
             for name in ("gray", "rgb")]  # fmt: skip
    assert means[1] == means[0] * 3


def test_lerobot_data_files_end_between_trajectories(moving: Path, tmp_path: Path, monkeypatch):
    monkeypatch.setattr(lerobot, "FILE_MEGABYTES", 1)
    monkeypatch.setattr(lerobot, "CHUNK_FILES", 2)
    load_exporter("lerobot")(moving, tmp_path / "out")
    files = sorted((tmp_path / "out" / "data").rglob("*.parquet"))
    names = [path.relative_to(tmp_path / "out").as_posix() for path in files]
    assert names[:3] == [
        "data/chunk-000/file-000.parquet",
        "data/chunk-000/file-001.parquet",
        "data/chunk-001/file-000.parquet",
    ]
    episodes = pq.read_table(tmp_path / "out" / "meta/episodes/chunk-000/file-000.parquet")
    places = zip(episodes["data/chunk_index"], episodes["data/file_index"], strict=True)
    told = [f"data/chunk-{c.as_py():03d}/file-{f.as_py():03d}.parquet" for c, f in places]
    for name, path in zip(names, files, strict=True):
        inside = set(pq.read_table(path, columns=["episode_index"])["episode_index"].to_pylist())
        assert inside == {index for index, where in enumerate(told) if where == name}


def test_lerobot_metadata(moving: Path, tmp_path: Path):
    made = load_exporter("lerobot")(moving, tmp_path / "out")
    info = json.loads((tmp_path / "out/meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0" and info["fps"] == made["fps"] == 30
    assert info["total_frames"] == 200 and info["total_episodes"] == 20
    assert list(info["splits"]) == ["train", "validation", "test"]
    tasks = pd.read_parquet(tmp_path / "out/meta/tasks.parquet")
    assert sorted(tasks["task_index"]) == [*range(5)] and "A4C" in " ".join(tasks.index)
    about = json.loads((tmp_path / "out/meta/racines.json").read_text())
    assert about["source"] == "phantom" and about["labels"][-1] == "Random"
    assert "simulated" in (tmp_path / "out/README.md").read_text().split("\n\n")[0]


def test_lerobot_statistics_leave_unknown_numbers_out(moving: Path, tmp_path: Path):
    load_exporter("lerobot")(moving, tmp_path / "out")
    text = (tmp_path / "out/meta/stats.json").read_text()
    assert "NaN" not in text
    state = json.loads(text)["observation.state"]
    values = np.concatenate(
        [s.table["force_x"].drop_null().to_numpy() for s in read_sweeps(moving)]
    )
    assert 0 < len(values) < 200
    assert state["mean"][0] == pytest.approx(values.mean(), rel=1e-4)
    assert state["std"][0] == pytest.approx(values.std(), rel=1e-4)
    assert state["q50"][0] == pytest.approx(np.median(values), rel=1e-4)


def test_minari_images_are_stored_as_they_are(moving: Path, tmp_path: Path):
    made = load_exporter("minari")(moving, tmp_path / "out", split="test")
    (name,) = made["datasets"]
    assert name == "racines/phantom-test-v0"
    data = tmp_path / "out" / name / "data"
    metadata = json.loads((data / "metadata.json").read_text())
    assert metadata["jpeg_encoding"] is False and metadata["total_episodes"] == 5
    assert "simulated" in metadata["description"] and "Reward" in metadata["description"]
    for episode, sweep in enumerate(read_sweeps(moving, "test")):
        with ipc.open_file(io.BytesIO((data / str(episode) / "part-0.arrow").read_bytes())) as file:
            assert file.num_record_batches == 1
            images = file.get_batch(0).column("observations").field("image")
        flat = np.stack(images.to_numpy(zero_copy_only=False))
        assert np.array_equal(flat.reshape(-1, 128, 128), sweep.images())


def test_minari_leaves_out_what_has_no_step(moving: Path, tmp_path: Path):
    with pytest.raises(RacinesError, match="no sweep has two frames, hence no step"):
        load_exporter("minari")(moving, tmp_path / "none", limit=1)
    assert not (tmp_path / "none").exists()
    first = len(next(iter(read_sweeps(moving))))
    made = load_exporter("minari")(moving, tmp_path / "out", limit=first + 1)
    assert made["trajectories"] == 1 and made["frames"] == first
    assert made["notes"][-1] == "1 sweeps of one frame have no step and are left out"


def test_minari_steps_pay_what_the_task_pays():
    views = np.array([1, 0, 0, 0, 2, -1, 0])
    grades = np.array([9, 2, 5, np.nan, 7, 7, 4])
    rewards, ended = judge_steps(views, grades, 0)
    # Comes to the view: 20 + 1 + 2 - 0.1; to a grade of 5: 50 + 3 - 0.1; then nobody knows.
    assert rewards == pytest.approx([22.9, 52.9, 0, 0, 0, 0])
    assert not ended.any()
    lost, _ = judge_steps(np.array([0, 2]), np.array([6.0, 9.0]), 0)
    assert lost == pytest.approx([-1.1])  # away from it
    rewards, ended = judge_steps(views, grades, None)
    assert not rewards.any() and not ended.any() and len(rewards) == 6  # a random scan


def test_minari_ends_where_three_hits_in_a_row_are_full():
    views = np.zeros(12, int)
    grades = np.array([9, 9, 9, 4, 9, 9, 9, 9, 9, np.nan, 9, 9])
    # The first observation is a start: what it shows is no step's hit.
    assert judge_steps(views, grades, 0)[1].nonzero()[0].tolist() == [5]


def test_minari_steps_are_those_of_the_environment():
    """A rollout of the task, written down as labels, is paid and ended as the task did it."""
    core = make_core("SC", 1, observation="params", reward="oracle")
    target = core.task.target
    core.reset(0, pose=core.phantom.target("SC"))
    views, grades, paid, ended = [int(core.info()["view"])], [core.info()["grade"]], [], []
    for action in (12, 12, 12):
        step = core.step(torch.tensor([action]))
        views.append(int(core.info()["view"]))
        grades.append(core.info()["grade"])
        paid.append(float(step.reward))
        ended.append(bool(step.terminated))
    rewards, ends = judge_steps(np.array(views), torch.cat(grades).double().numpy(), target)
    assert ended == [False, False, True] == ends.tolist()
    assert rewards == pytest.approx(paid, abs=0.2)  # the task's p is a membership, not 0 or 1


def test_minari_returns_are_not_all_nothing(tiny_root: Path, tmp_path: Path):
    made = load_exporter("minari")(tiny_root, tmp_path / "out")
    returns, ended = [], 0
    for name in made["datasets"]:
        for path in sorted((tmp_path / "out" / name / "data").glob("*/part-0.arrow")):
            with ipc.open_file(path.read_bytes()) as file:
                batch = file.get_batch(0)
            returns.append(np.sum(batch.column("rewards").to_numpy()[:-1]))
            ended += batch.column("terminations").to_numpy(zero_copy_only=False).sum()
            last = [batch.column(f"{how}s")[-2].as_py() for how in ("termination", "truncation")]
            assert sum(last) == 1, "an episode ends once"
    assert len(returns) == 16 and np.count_nonzero(returns) > 8 and max(returns) > 50
    assert ended > 0


def test_minari_names_an_environment_that_can_be_made(tiny_root: Path, tmp_path: Path):
    made = load_exporter("minari")(tiny_root, tmp_path / "out")
    for name in made["datasets"]:
        text = (tmp_path / "out" / name / "data" / "metadata.json").read_text()
        spec = EnvSpec.from_json(json.loads(text)["env_spec"])
        env = gymnasium.make(spec, termination="timeout")
        seen, _ = env.reset(seed=1)
        assert env.observation_space.contains(seen)
        assert spec.kwargs["reward"] == "oracle" and set(seen) == {"image", "params"}
        other = gymnasium.make(spec, view="A4C" if spec.kwargs["view"] == "SC" else "SC")
        assert other.unwrapped.core.task.view != spec.kwargs["view"]  # pyright: ignore


def test_minari_names_the_phantom_that_was_scanned_or_no_environment():
    own = PhantomConfig(block=BlockConfig(voxel=0.004))
    settings = {"phantom": PHANTOM_VERSION, "acquisition": {"phantom": asdict(own)}}
    spec = env_spec({"source": "phantom", "recipe": {"settings": settings}}, ["Random", "A4C"])
    assert spec is not None
    env = gymnasium.make(EnvSpec.from_json(spec))
    assert env.unwrapped.core.phantom.config == own  # pyright: ignore
    assert env.unwrapped.core.task.view == "A4C"  # pyright: ignore
    old = {"settings": {**settings, "phantom": "0.0.0"}}
    assert env_spec({"source": "phantom", "recipe": old}, ["A4C"]) is None
    assert env_spec({"source": "release", "recipe": {}}, ["A4C"]) is None
    same = {"settings": {**settings, "acquisition": {"phantom": asdict(PhantomConfig())}}}
    assert env_spec({"source": "phantom", "recipe": same}, ["Random"]) is None  # no target


def test_the_command(moving: Path, tmp_path: Path):
    words = ("racines", "data", "export", str(moving), "--out", "out")
    done = command(tmp_path, *words, "--format", "lerobot", "--limit", "20", "--json")
    assert json.loads(done.stdout)["trajectories"] == 2
    again = command(tmp_path, *words, "--format", "lerobot", code=1)
    assert "exists; name a new folder" in again.stderr
    assert set(exporter_names()) >= {"release", "lerobot", "minari"}
    unknown = command(tmp_path, *words, "--format", "zarr", code=1)
    assert "choose one of lerobot, lerobot-rgb, lerobot-task, minari, release" in unknown.stderr
    command(tmp_path, *words, code=2)
