from pathlib import Path

import datasets
import numpy as np
import pytest

import racines_data
from racines_data import RacinesError
from racines_data.build.dataset import DataConfig, build
from racines_data.views import LABELS
from tests.data.fake_source import FakeConfig, FakeSource


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder laid out as the repository is, and work in it."""
    (tmp_path / "data").mkdir()
    (tmp_path / "racines").symlink_to("data/racines")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def make(root: Path, seed: int = 0, frames: int = 200) -> dict:
    return build(FakeSource(FakeConfig(seed=seed, frames=frames)), root, DataConfig(workers=1))


def test_repository_links_to_its_dataset():
    link = Path(__file__).parents[2] / "racines"
    assert link.is_symlink() and str(link.readlink()) == "data/racines"
    assert not (link / "racines.py").exists()


def test_load_dataset_by_name(checkout: Path):
    make(checkout / "data" / "racines")
    loaded = datasets.load_dataset("racines")
    assert {name: len(split) for name, split in loaded.items()} == {
        "train": 100,
        "validation": 50,
        "test": 50,
    }
    features = loaded["train"].features
    assert features["image"] == datasets.Image(mode="L")
    assert features["view"].names == list(LABELS)
    row = loaded["train"][0]
    assert row["image"].size == (128, 128) and row["image"].mode == "L"
    assert features["source"].int2str(row["source"]) == "phantom"
    first = FakeSource().produce(next(u for u in FakeSource().plan() if u.id == row["trajectory"]))
    assert np.array_equal(np.asarray(row["image"]), first.images[0])
    assert row["force_x"] == first.parameters[0, 0]


def test_streaming(checkout: Path):
    make(checkout / "data" / "racines")
    stream = datasets.load_dataset("racines", split="train", streaming=True)
    assert stream.num_shards == 8
    rows = list(stream)
    assert len(rows) == 100 and rows[0]["image"].size == (128, 128)
    assert stream.features["view"].names == list(LABELS)


def test_a_rebuilt_dataset_is_not_served_stale(checkout: Path):
    root = checkout / "data" / "racines"
    make(root, seed=0)
    before = datasets.load_dataset("racines")
    make(root, seed=1)
    after = datasets.load_dataset("racines")
    stream = datasets.load_dataset("racines", split="train", streaming=True)
    assert after["train"]["position_x"][:] != before["train"]["position_x"][:]
    assert after["train"]["position_x"][:] == [row["position_x"] for row in stream]
    assert set(after["train"]["trajectory"]) == set(stream_column(stream, "trajectory"))


def stream_column(stream, name: str) -> list:
    return [row[name] for row in stream]


def test_load_has_all_configs(built: Path):
    frames = racines_data.load(root=built)
    assert frames["train"].info.description.startswith("source phantom (simulated")
    trajectories = racines_data.load(config="trajectories", root=built)
    assert sum(len(part) for part in trajectories.values()) == 20
    assert set(trajectories["test"]["split"]) == {"test"}
    sessions = racines_data.load(config="sessions", root=built)
    assert set(sessions["train"]["session"]) == {"s0"}
    assert set(sessions["test"]["session"]) == {"s1"}
    assert len(sessions["train"]) + len(sessions["test"]) == 200


def test_absent_measurements_are_null(built: Path):
    row = racines_data.load(split="train", root=built)[9]
    assert row["force_x"] is None and row["control_x"] is None
    assert isinstance(row["position_x"], float)


def test_load_refuses_what_is_not_there(built: Path, tmp_path: Path):
    with pytest.raises(RacinesError, match="no dataset here; build one: racines data build"):
        racines_data.load(root=tmp_path / "none")
    with pytest.raises(RacinesError, match=r"holds phantom 0\.1\.0, not 9\.0\.0"):
        racines_data.load(version="9.0.0", root=built)
    with pytest.raises(RacinesError, match="unknown config 'frame'"):
        racines_data.load(config="frame", root=built)
    with pytest.raises(RacinesError, match="unknown split 'dev'"):
        racines_data.load(split="dev", root=built)
    assert len(racines_data.load(version="0.1.0", split="test", root=built)) == 50


def test_a_damaged_shard_is_named(tmp_path: Path):
    root = tmp_path / "racines"
    manifest = make(root)
    racines_data.load(root=root)
    name = manifest["configs"]["frames"]["train"][2]
    content = bytearray((root / name).read_bytes())
    content[len(content) // 2] ^= 1
    (root / name).write_bytes(bytes(content))
    with pytest.raises(RacinesError, match=f"{name}: damaged .*rebuild it: racines data build"):
        racines_data.load(root=root)
    (root / name).write_bytes(bytes(content[:100]))
    with pytest.raises(RacinesError, match=f"{name}: damaged .100 bytes"):
        racines_data.load(root=root)
    (root / name).unlink()
    with pytest.raises(RacinesError, match=f"{name}: missing"):
        racines_data.load(root=root)


def test_a_damaged_manifest_is_named(tmp_path: Path):
    make(tmp_path / "racines")
    path = tmp_path / "racines" / "manifest.json"
    path.write_text(path.read_text()[:200])
    with pytest.raises(RacinesError, match="manifest.json: damaged"):
        racines_data.load(root=tmp_path / "racines")


def test_unchanged_files_are_hashed_once(built: Path, monkeypatch: pytest.MonkeyPatch):
    racines_data.load(root=built)
    monkeypatch.setattr("racines_data.digest.sha256_file", lambda path: pytest.fail("hashed again"))
    racines_data.load(root=built)
