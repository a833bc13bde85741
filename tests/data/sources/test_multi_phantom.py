import pickle
from pathlib import Path

import datasets
import numpy as np
import pytest

import racines_data
from racines_data.build.dataset import (
    DataConfig,
    build,
    make_multi_phantom,
    make_source,
    read_data_section,
)
from racines_data.errors import RacinesError
from racines_data.manifest import read_manifest
from racines_data.phantom.acquisition import AcquisitionConfig
from racines_data.phantom.config import BlockConfig, PhantomConfig, heart_config
from racines_data.sources.phantom import MultiPhantomSource, PhantomSource
from racines_data.store.frames import FrameStore
from racines_data.validate.identity import same_version
from racines_data.views import LABELS
from tests.data.build.test_build import files
from tests.data.fake_source import FakeConfig, FakeSource

HEARTS = {"frames": 144, "trajectories": 48, "sessions": 8, "views": LABELS}


def make(root: Path, workers: int = 1, **config) -> dict:
    many = FakeSource(FakeConfig(**{**HEARTS, "seed": 5, **config}))
    return build(FakeSource(FakeConfig()), root, DataConfig(workers=workers), many=many)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("many") / "racines"
    make(folder)
    return folder


def test_manifest(root: Path, built: Path):
    manifest, plain = read_manifest(root), read_manifest(built)
    many = manifest["multi_phantom"]
    assert (many["hearts"], many["trajectories"], many["frames"]) == (8, 48, 144)
    assert {name: count["hearts"] for name, count in many["splits"].items()} == {
        "train": 6,
        "validation": 1,
        "test": 1,
    }
    assert sum(count["frames"] for count in many["splits"].values()) == 144
    assert manifest["digest"] == plain["digest"], "the digest of `frames` does not include it"
    assert many["digest"] != manifest["digest"]
    assert manifest["recipe_digest"] != plain["recipe_digest"]
    assert manifest["tag"] == "phantom-v0.1.0"
    assert len(many["canonical"]) == 6
    assert "multi_phantom" not in plain and "multi_phantom" not in plain["configs"]


def test_a_heart_is_in_one_split(root: Path):
    splits = racines_data.load(config="multi_phantom", root=root)
    hearts = {name: set(part["session"]) for name, part in splits.items()}
    assert {name: len(each) for name, each in hearts.items()} == {
        "train": 6,
        "validation": 1,
        "test": 1,
    }
    assert len(set.union(*hearts.values())) == 8
    assert splits["train"].features == racines_data.load(root=root, split="train").features


def test_its_store_holds_the_same_rows(root: Path):
    store = racines_data.open_store(root, config="multi_phantom")
    manifest = read_manifest(root)
    assert len(store) == 144 and store.digest == manifest["multi_phantom"]["digest"]
    assert racines_data.open_store(root).digest == manifest["digest"]
    for split, part in racines_data.load(config="multi_phantom", root=root).items():
        rows = store.split_indices(split)
        assert len(rows) == len(part)
        images = np.stack([np.asarray(image) for image in part["image"]])
        assert np.array_equal(store.images[rows].numpy(), images)
        owners = [store.trajectories[i] for i in store.trajectory_index[rows].tolist()]
        assert owners == part["trajectory"][:]
    again = pickle.loads(pickle.dumps(store))
    assert again.config == "multi_phantom" and len(again) == 144


@pytest.mark.usefixtures("warm_workers")
def test_bytes_depend_neither_on_workers_nor_on_the_build(root: Path, tmp_path: Path):
    make(tmp_path / "two", workers=2)
    assert files(tmp_path / "two") == files(root)


def test_a_rebuilt_config_is_not_served_stale(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    make(Path("racines"))
    before = datasets.load_dataset("racines", "multi_phantom")
    frames = datasets.load_dataset("racines", split="train")
    make(Path("racines"), seed=6)
    after = datasets.load_dataset("racines", "multi_phantom")
    assert after["train"]["position_x"][:] != before["train"]["position_x"][:]
    assert datasets.load_dataset("racines", split="train")["force_x"][:] == frames["force_x"][:]


@pytest.mark.usefixtures("warm_workers")
def test_one_worker_makes_all_of_a_heart(tmp_path: Path):
    journal = tmp_path / "journal"
    journal.mkdir()
    make(tmp_path / "racines", workers=2, journal=str(journal), processes=2)
    marks = {tuple(path.read_text().split()) for path in journal.iterdir()}
    hearts = [heart for _, heart in marks]
    assert len(hearts) == len(set(hearts)) == 8, "a heart was given to two workers"
    assert len({process for process, _ in marks}) == 2


def test_without_the_config_its_store_is_refused(built: Path):
    with pytest.raises(RacinesError, match="names no store/multi_phantom.arrow.*hearts set"):
        FrameStore(built, "multi_phantom")
    with pytest.raises(RacinesError, match="config 'sessions' has no store"):
        FrameStore(built, "sessions")
    with pytest.raises(RacinesError, match="unknown config 'multi_phantom'"):
        racines_data.load(config="multi_phantom", root=built)


def test_same_version_looks_at_the_hearts_too(root: Path, tmp_path: Path):
    assert same_version(root, root) == "equal, byte for byte"
    make(tmp_path / "other", seed=6)
    path = tmp_path / "other" / "manifest.json"
    recipe = read_manifest(root)["recipe_digest"]
    path.write_text(path.read_text().replace(read_manifest(path.parent)["recipe_digest"], recipe))
    with pytest.raises(RacinesError, match="canonical frames differ"):
        same_version(root, tmp_path / "other")


def test_settings():
    values = {"frames": 9, "phantom": {"tremor": 0.0}, "multi_phantom": {"hearts": 3}}
    config, sections = read_data_section(values)
    source = make_source(config, sections["phantom"])
    many = make_multi_phantom(source, config, sections["multi_phantom"])
    assert isinstance(many, MultiPhantomSource)
    assert many.acquisition.tremor == 0.0 and many.config.seed == config.seed
    assert make_multi_phantom(source, config) is None
    assert make_multi_phantom(FakeSource(), config, {"hearts": 3}) is None
    with pytest.raises(RacinesError, match="data.multi_phantom.heart: unknown key"):
        make_multi_phantom(source, config, {"heart": 3})
    with pytest.raises(RacinesError, match="hearts must be 0 or more"):
        make_multi_phantom(source, config, {"hearts": -1})


def test_plan_has_a_sweep_per_view_and_heart():
    many = MultiPhantomSource.from_config({"hearts": 3, "frames_per_sweep": 7})
    units = many.plan()
    assert len(units) == 18 and {unit.frames for unit in units} == {7}
    assert [unit.target_view for unit in units[:6]] == list(LABELS)
    assert [unit.heart for unit in units] == [1] * 6 + [2] * 6 + [3] * 6


def test_a_seed_is_another_heart_with_its_own_scatterers():
    base = PhantomConfig()
    one, two = heart_config(base, 1), heart_config(base, 2)
    assert (one.anatomy_seed, two.anatomy_seed) == (1, 2)
    assert len({base.block.seed, one.block.seed, two.block.seed}) == 3


@pytest.mark.slow
def test_hearts_are_scanned_each_by_itself():
    coarse = PhantomConfig(block=BlockConfig(voxel=0.004))  # fine blocks are baked for seconds
    many = MultiPhantomSource.from_config(
        {"hearts": 2, "frames_per_sweep": 4}, acquisition=AcquisitionConfig(phantom=coarse)
    )
    units = [many.plan()[0], many.plan()[6]]
    one, two = (many.produce(unit) for unit in units)
    again = pickle.loads(pickle.dumps(many)).produce(units[0])
    assert np.array_equal(one.images, again.images)
    assert (one.phantom, two.phantom) == (1, 2) and len(one) == 4
    canonical = PhantomSource(AcquisitionConfig(frames=4, shortest=2, phantom=coarse))
    assert canonical.produce(canonical.plan()[0]).phantom == 0
    assert not np.array_equal(one.images, two.images)
