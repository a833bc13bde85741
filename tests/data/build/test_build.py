import os
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from racines_data.build.dataset import DataConfig, build, make_source, read_data_section
from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_data.load import load
from racines_data.manifest import read_manifest
from racines_data.schema import Trajectory
from racines_data.sources.base import Finding, Unit, source_class
from racines_data.validate.run import validate
from tests.data.fake_source import FakeConfig, FakeSource


def files(root: Path) -> dict[str, str]:
    paths = (path for path in root.rglob("*") if path.is_file())
    return {str(path.relative_to(root)): sha256_file(path) for path in paths}


def test_bytes_depend_neither_on_workers_nor_on_the_build(built: Path, tmp_path: Path):
    build(FakeSource(FakeConfig()), tmp_path / "two", DataConfig(workers=2))
    assert files(tmp_path / "two") == files(built)


def test_another_seed_is_another_dataset(built: Path, tmp_path: Path):
    manifest = build(FakeSource(FakeConfig(seed=1)), tmp_path / "b", DataConfig(workers=1, seed=1))
    before = read_manifest(built)
    assert manifest["digest"] != before["digest"]
    assert manifest["recipe_digest"] != before["recipe_digest"]


def test_layout(built: Path):
    manifest = read_manifest(built)
    shards = [path for paths in manifest["configs"]["frames"].values() for path in paths]
    assert len(shards) == 16
    assert sum(pq.read_metadata(built / path).num_rows for path in shards) == 200
    assert set(manifest["configs"]["frames"]) == {"train", "validation", "test"}
    on_disk = {name for name in files(built) if name != "manifest.json"}
    assert set(manifest["files"]) == on_disk
    assert all(files(built)[name] == seal["sha256"] for name, seal in manifest["files"].items())
    assert len(manifest["canonical"]) == 5
    first = (built / "README.md").read_text().split("---\n")[2].splitlines()[0]
    assert "`phantom`" in first and "simulated" in first


def test_number_of_shards_does_not_change_the_content(built: Path, tmp_path: Path):
    manifest = build(FakeSource(FakeConfig()), tmp_path / "b", DataConfig(workers=1, shards=40))
    assert manifest["digest"] == read_manifest(built)["digest"]
    assert sum(len(paths) for paths in manifest["configs"]["frames"].values()) == 40


def test_one_session_has_no_sessions_config(tmp_path: Path):
    source = FakeSource(FakeConfig(sessions=1))
    manifest = build(source, tmp_path / "b", DataConfig(workers=1))
    assert manifest["held_out_session"] is None and "sessions" not in manifest["configs"]
    assert "only one session" in (tmp_path / "b" / "README.md").read_text()


@pytest.mark.parametrize("trajectories", [1, 2, 3])
def test_tiny_datasets_have_as_many_shards_as_rows(tmp_path: Path, trajectories: int):
    source = FakeSource(FakeConfig(frames=6, trajectories=trajectories))
    manifest = build(source, tmp_path / "b", DataConfig(workers=1))
    assert sum(len(paths) for paths in manifest["configs"]["frames"].values()) == 6
    assert len(manifest["configs"]["frames"]) == trajectories


def staged(folder: Path) -> list[Path]:
    return sorted(folder.glob(".racines.staging-*/*/units/*.arrow"))


def test_a_damaged_staged_unit_is_made_again(built: Path, tmp_path: Path):
    class Stops(FakeSource):
        def produce(self, unit: Unit) -> Trajectory:
            if unit.id == "t010":
                raise RacinesError("stopped")
            return super().produce(unit)

    out = tmp_path / "racines"
    with pytest.raises(RacinesError, match="stopped"):
        build(Stops(FakeConfig()), out, DataConfig(workers=1))
    unit = staged(tmp_path)[3]
    unit.write_bytes(unit.read_bytes()[:1000])
    manifest = build(Stops.__base__(FakeConfig()), out, DataConfig(workers=1))  # type: ignore
    assert manifest["digest"] == read_manifest(built)["digest"]


def test_what_another_recipe_left_is_removed(tmp_path: Path):
    class Stops(FakeSource):
        def produce(self, unit: Unit) -> Trajectory:
            raise RacinesError("stopped")

    with pytest.raises(RacinesError):
        build(Stops(FakeConfig(seed=9)), tmp_path / "racines", DataConfig(workers=1))
    assert len(list(tmp_path.glob(".racines.staging-*"))) == 1
    build(FakeSource(FakeConfig()), tmp_path / "racines", DataConfig(workers=1))
    assert [path.name for path in tmp_path.iterdir()] == ["racines"]


def test_two_builds_at_once_are_refused(tmp_path: Path):
    class Nested(FakeSource):
        def produce(self, unit: Unit) -> Trajectory:
            build(Nested(self.config), tmp_path / "racines", DataConfig(workers=1))
            raise AssertionError("the second build was let in")

    with pytest.raises(RacinesError, match="another build of it is running"):
        build(Nested(FakeConfig()), tmp_path / "racines", DataConfig(workers=1))


def test_a_link_to_the_dataset_stays_a_link(tmp_path: Path):
    (tmp_path / "racines").symlink_to("data/racines")
    build(FakeSource(FakeConfig()), tmp_path / "racines", DataConfig(workers=1))
    assert (tmp_path / "racines").is_symlink()
    assert read_manifest(tmp_path / "data" / "racines")["counts"]["frames"] == 200


def test_a_failed_rebuild_leaves_the_old_dataset(tmp_path: Path):
    out = tmp_path / "racines"
    before = build(FakeSource(FakeConfig()), out, DataConfig(workers=1))

    class Bad(FakeSource):
        def produce(self, unit: Unit) -> Trajectory:
            trajectory = super().produce(unit)
            trajectory.parameters[1, 7] = float("nan")
            return trajectory

    with pytest.raises(RacinesError, match="position_y of frame 1 is not finite"):
        build(Bad(FakeConfig(seed=3)), out, DataConfig(workers=1))
    assert read_manifest(out) == before


def test_an_error_in_a_worker_arrives_whole(tmp_path: Path, warm_workers: None):
    with pytest.raises(RacinesError, match=r"trajectory t\d+: unknown target view 'A5C'"):
        build(FakeSource(FakeConfig(views=("A5C",))), tmp_path / "b", DataConfig(workers=2))


def test_foreign_folder_is_not_overwritten(tmp_path: Path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(RacinesError, match="not a dataset"):
        build(FakeSource(), tmp_path, DataConfig(workers=1))
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_an_interrupted_swap_is_undone(built: Path, tmp_path: Path):
    out = tmp_path / "racines"
    build(FakeSource(FakeConfig()), out, DataConfig(workers=1))
    os.replace(out, tmp_path / ".racines.old")
    with pytest.raises(RacinesError):
        build(FakeSource(FakeConfig(views=("A5C",))), out, DataConfig(workers=1))
    assert files(out) == files(built)


def test_refused_frames_are_limited(tmp_path: Path):
    class Refuses(FakeSource):
        def plan(self) -> list[Unit]:
            self.report = [Finding("a.mha", "frame 3", True, "left-handed", 60)]
            return super().plan()

    source = Refuses(FakeConfig())
    with pytest.raises(RacinesError, match="60 of 260 frames refused.*a.mha frame 3: left-handed"):
        build(source, tmp_path / "b", DataConfig(workers=1))
    with pytest.raises(RacinesError, match="strict.*left-handed"):
        build(source, tmp_path / "b", DataConfig(workers=1, max_refused=0.5, strict=True))
    manifest = build(source, tmp_path / "b", DataConfig(workers=1, max_refused=0.5))
    rows = pq.read_table(tmp_path / "b" / "import_report.parquet").to_pylist()
    assert [row["reason"] for row in rows] == ["left-handed"]
    assert manifest["report"]["refused_frames"] == 60


def test_unknown_source_is_refused_by_name():
    with pytest.raises(
        RacinesError, match="unknown source 'phantm': did you mean 'phantom'. choose"
    ):
        source_class("phantm")


def test_a_source_can_be_named_by_module_and_class():
    source = make_source(DataConfig(source="tests.data.fake_source:FakeSource", frames=7, seed=5))
    assert isinstance(source, FakeSource)
    assert (source.config.frames, source.config.seed) == (7, 5)


def test_a_source_of_another_package_names_itself(tmp_path: Path):
    class Mine(FakeSource):
        name = "mine"

    root = tmp_path / "racines"
    build(Mine(FakeConfig()), root, DataConfig(workers=1))
    rows = load(root=root, split="test")
    assert set(rows.features["source"].int2str(rows["source"][:])) == {"mine"}
    assert validate(root).ok


def test_data_section():
    config, sections = read_data_section({"frames": 9, "phantom": {"x": 1}, "tracked": None})
    assert config.frames == 9 and sections == {"phantom": {"x": 1}, "tracked": {}}
    with pytest.raises(RacinesError, match="data.farmes: unknown key"):
        read_data_section({"farmes": 9})
