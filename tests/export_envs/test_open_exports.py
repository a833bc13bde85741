"""Exports opened by the real libraries, each in an environment of its own: `make test-exports`.

Without these environments the tests are skipped. They ask of the library, in its own interpreter,
for every frame, and compare with what our loader reads.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from racines_data.export.registry import load_exporter
from racines_data.records import float_columns
from racines_data.schema import CONTROLS, PARAMETERS
from racines_data.store.sweeps import Sweep, read_sweeps
from racines_data.views import LABELS
from tests.conftest import ROOT
from tests.export_envs.running import HERE, run_in

pytestmark = pytest.mark.timeout(600)


@pytest.fixture(scope="module")
def sweeps(tiny_root: Path) -> list[Sweep]:
    return list(read_sweeps(tiny_root))


@pytest.fixture(scope="module")
def lerobot(tiny_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict]:
    folder = tmp_path_factory.mktemp("lerobot")
    load_exporter("lerobot")(tiny_root, folder / "export")
    variables = {"HF_HOME": str(folder / "home"), "HF_LEROBOT_HOME": str(folder / "home")}
    out = str(folder / "read.npz")
    run_in("lerobot", str(HERE / "lerobot_reader.py"), str(folder / "export"), out, **variables)
    with np.load(out) as read:
        yield {**read, **json.loads(str(read["about"]))}


def whole(sweeps: list[Sweep], names: tuple[str, ...]) -> np.ndarray:
    return np.concatenate([float_columns(sweep.table, names) for sweep in sweeps])


def test_lerobot_images_are_equal_pixel_for_pixel(lerobot: dict, sweeps: list[Sweep]):
    expected = np.concatenate([sweep.images() for sweep in sweeps])
    assert lerobot["images"].shape == (len(expected), 1, 128, 128)
    assert np.array_equal(np.rint(lerobot["images"][:, 0] * 255).astype(np.uint8), expected)
    assert lerobot["coloured"].shape == (3, 128, 128)
    assert (lerobot["coloured"] == lerobot["images"][0]).all()


def test_lerobot_states_actions_and_labels_are_equal(lerobot: dict, sweeps: list[Sweep]):
    assert np.array_equal(lerobot["states"], whole(sweeps, PARAMETERS), equal_nan=True)
    assert np.array_equal(lerobot["actions"], whole(sweeps, CONTROLS), equal_nan=True)
    assert np.array_equal(lerobot["grades"], whole(sweeps, ("grade",))[:, 0], equal_nan=True)
    views = np.concatenate([s.table["view"].fill_null(-1).to_numpy() for s in sweeps])
    assert np.array_equal(lerobot["views"], views)
    assert lerobot["names"] == list(PARAMETERS)


def test_lerobot_episodes_have_the_bounds_of_the_trajectories(lerobot: dict, sweeps: list[Sweep]):
    ends = np.cumsum([len(sweep) for sweep in sweeps])
    assert np.array_equal(lerobot["bounds"][:, 1], ends)
    assert np.array_equal(lerobot["bounds"][:, 0], ends - [len(sweep) for sweep in sweeps])
    assert lerobot["trajectories"] == [sweep.id for sweep in sweeps]
    owner = np.repeat(np.arange(len(sweeps)), [len(sweep) for sweep in sweeps])
    assert np.array_equal(lerobot["episode_index"], owner)
    assert np.array_equal(
        lerobot["frame_index"], np.concatenate([np.arange(len(s)) for s in sweeps])
    )
    chosen = [*range(*lerobot["bounds"][1]), *range(*lerobot["bounds"][3])]
    assert lerobot["some"].tolist() == chosen
    assert {path for path in lerobot["files"]} == {"data/chunk-000/file-000.parquet"}


def test_lerobot_windows_stay_within_an_episode(lerobot: dict):
    assert lerobot["fps"] == 25
    assert np.allclose(lerobot["timestamps"], lerobot["frame_index"] / 25, atol=1e-4)
    assert np.array_equal(lerobot["window_actions"][:, 0], lerobot["actions"][:8])
    assert np.array_equal(lerobot["window_actions"][:, 1], lerobot["actions"][1:9])
    assert np.array_equal(lerobot["window_images"][1:, 0], lerobot["images"][:7])
    assert not lerobot["window_padded"].any()


def test_lerobot_splits_tasks_and_statistics(lerobot: dict, sweeps: list[Sweep]):
    splits = {}
    for index, sweep in enumerate(sweeps):
        splits.setdefault(sweep.split, []).append(index)
    assert lerobot["splits"] == {name: f"{i[0]}:{i[-1] + 1}" for name, i in splits.items()}
    for task, index in zip(lerobot["tasks"], lerobot["episode_index"], strict=True):
        view = sweeps[index].first("target_view")
        assert f" {view} view" in task or (view == "Random" and "freely" in task)
    assert np.allclose(lerobot["stats_mean"], lerobot["library_mean"], rtol=1e-4, atol=1e-6)
    assert np.allclose(lerobot["stats_std"], lerobot["library_std"], rtol=1e-3, atol=1e-6)


@pytest.fixture(scope="module")
def minari(tiny_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict]:
    folder = tmp_path_factory.mktemp("minari")
    load_exporter("minari")(tiny_root, folder / "export")
    out = str(folder / "read.npz")
    path = str(folder / "export")
    run_in("minari", str(HERE / "minari_reader.py"), out, MINARI_DATASETS_PATH=path)
    with np.load(out) as read:
        yield {**read, "about": json.loads(str(read["about"]))}


def test_minari_lists_one_dataset_a_split(minari: dict, sweeps: list[Sweep]):
    expected: dict[str, list[Sweep]] = {}
    for sweep in sweeps:
        expected.setdefault(f"racines/phantom-{sweep.split}-v", []).append(sweep)
    assert len(minari["about"]) == len(expected) == 3
    for name, about in minari["about"].items():
        of = expected[name.rstrip("0123456789")]
        assert about["episodes"] == len(of)
        assert about["steps"] == sum(len(sweep) - 1 for sweep in of)
        assert [each["trajectory"] for each in about["about"]] == [sweep.id for sweep in of]
        assert about["in_space"] and about["sampled"] == 1
        assert "(1, 128, 128), uint8" in about["observation_space"]
        assert about["action_space"] == "Box(-inf, inf, (6,), float32)"


def episodes(minari: dict, sweeps: list[Sweep]) -> Iterator[tuple[str, Sweep]]:
    numbers: dict[str, int] = {}
    names = {name.split("-")[1]: name for name in minari["about"]}
    for sweep in sweeps:
        number = numbers.setdefault(sweep.split, 0)
        numbers[sweep.split] += 1
        yield f"{names[sweep.split]}/{number}", sweep


def test_minari_episodes_are_equal_pixel_for_pixel(minari: dict, sweeps: list[Sweep]):
    for key, sweep in episodes(minari, sweeps):
        assert minari[f"{key}/images"].dtype == np.uint8
        assert np.array_equal(minari[f"{key}/images"][:, 0], sweep.images())
        params = float_columns(sweep.table, PARAMETERS)
        assert np.array_equal(minari[f"{key}/params"], params, equal_nan=True)
        actions = float_columns(sweep.table, CONTROLS)[:-1]
        assert np.array_equal(minari[f"{key}/actions"], actions, equal_nan=True)


def test_minari_rewards_are_those_of_the_task(minari: dict, sweeps: list[Sweep]):
    paid, ended = [], 0
    for key, sweep in episodes(minari, sweeps):
        rewards, ends = minari[f"{key}/rewards"], minari[f"{key}/terminations"]
        assert len(rewards) == len(ends) == len(sweep) - 1
        views, grades = minari[f"{key}/infos/view"], minari[f"{key}/infos/grade"]
        target = sweep.first("target_view")
        if target == "Random":
            assert not rewards.any() and not ends.any()
            continue
        shown = views == LABELS.index(target)
        grade = np.where(shown, grades, 0)
        base = np.where(shown, np.where(grade >= 5, 50, 20), 0)[1:]
        change = np.diff(shown.astype(float)) + np.where(shown[1:], np.diff(grade), 0)
        assert np.allclose(rewards, base + change - 0.1, atol=1e-4)
        paid.append(rewards.sum())
        ended += ends.sum()
    assert len(set(paid)) > 5 and max(paid) > 50 and ended > 0


def test_minari_sweeps_end_once_and_have_their_infos(minari: dict, sweeps: list[Sweep]):
    for key, sweep in episodes(minari, sweeps):
        cut, ended = minari[f"{key}/truncations"], minari[f"{key}/terminations"]
        assert cut[-1] != ended[-1] and not cut[:-1].any()
        assert np.array_equal(minari[f"{key}/infos/timestamp"], sweep.table["timestamp"].to_numpy())
        assert np.array_equal(minari[f"{key}/infos/frame"], np.arange(len(sweep)))


def test_minari_recovers_the_environment(tiny_root: Path, tmp_path: Path):
    """The real library makes ours: its pure Python, from its environment, in this interpreter."""
    load_exporter("minari")(tiny_root, tmp_path / "export", split="train")
    places = sorted((ROOT / ".venv-minari").glob("lib/python*/site-packages"))
    if not places:
        pytest.skip("no environment .venv-minari: make test-exports makes it")
    variables = {"MINARI_DATASETS_PATH": str(tmp_path / "export")}
    words = [sys.executable, str(HERE / "minari_recovering.py"), str(places[0])]
    done = subprocess.run(words, env=os.environ | variables, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    told = json.loads(done.stdout.splitlines()[-1])
    assert told["spaces"] and told["steps"] == 3 and told["view"] == "SC"
    assert told["id"].startswith("racines/") and told["reward"] == "oracle"
