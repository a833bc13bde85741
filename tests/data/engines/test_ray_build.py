"""A dataset that Ray built has the bytes of one that was built here."""

from pathlib import Path

import pytest

from racines_data.build.dataset import DataConfig, build
from racines_data.engines.ray import RayEngine
from racines_data.sources.patients import PatientsSource
from racines_data.sources.phantom import PhantomSource
from tests.data.build.test_build import files
from tests.data.engines.tasks import DyingSource
from tests.data.fake_source import FakeConfig, FakeSource

ONE = DataConfig(workers=1, shards=2)
SWEEPS = {"frames": 20, "shortest": 10, "longest": 10}


def test_a_build_of_the_phantom_has_the_same_bytes(engine: RayEngine, tmp_path: Path):
    for name, by in (("here", None), ("ray", engine)):
        build(PhantomSource.from_config(SWEEPS, []), tmp_path / name, ONE, engine=by)
    assert files(tmp_path / "ray") == files(tmp_path / "here")


def test_a_worker_killed_in_a_build_costs_its_unit_only(engine: RayEngine, tmp_path: Path):
    config = FakeConfig(frames=100, journal=str(tmp_path / "journal"))
    (tmp_path / "journal").mkdir()
    build(DyingSource(config), tmp_path / "ray", ONE, engine=engine)
    build(FakeSource(FakeConfig(frames=100)), tmp_path / "here", ONE)
    assert (tmp_path / "journal" / "t007.died").exists()
    made = [path.name[:4] for path in (tmp_path / "journal").glob("*-*")]
    assert sorted(made) == [f"t{n:03d}" for n in range(20)], "each unit was made once"
    assert files(tmp_path / "ray") == files(tmp_path / "here")


@pytest.mark.thorough
def test_patients_have_the_same_bytes(engine: RayEngine, tmp_path: Path):
    settings = {"train": 1, "validation": 1, "test": 0, "frames_per_sweep": 2}
    for name, by in (("here", None), ("ray", engine)):
        root = tmp_path / name
        build(FakeSource(FakeConfig(frames=20)), root, ONE)
        build(PatientsSource.from_config(settings), root, ONE, engine=by)
    assert files(tmp_path / "ray") == files(tmp_path / "here")
