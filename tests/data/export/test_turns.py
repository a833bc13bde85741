"""Recorded turns in other people's formats: what has no times and no actions is said, not made."""

from pathlib import Path

import pytest

from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.export.registry import load_exporter
from racines_data.sources.rotation.source import RotationSource
from tests.data.sources.rotation_folder import write_rotation

ONE = DataConfig(workers=1, shards=1)


def made(folder: Path, phases: int, **settings) -> Path:
    source = RotationSource.from_config(
        settings, [write_rotation(folder / "heart", turns=24, phases=phases)]
    )
    build(source, folder / "turns", ONE)
    return folder / "turns"


@pytest.mark.parametrize("phases", [1, 3])
@pytest.mark.parametrize("name", ["lerobot", "lerobot-rgb", "minari"])
def test_formats_of_actions_refuse_turns(tmp_path: Path, name: str, phases: int):
    turns = made(tmp_path, phases)
    with pytest.raises(RacinesError, match="rotation data have no commanded velocity"):
        load_exporter(name)(turns, tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir() if "out" in path.name] == []


def test_the_published_layout_wants_metres_and_times(tmp_path: Path):
    release = load_exporter("release")
    with pytest.raises(RacinesError, match="positions are in pixels.*--pixel-mm"):
        release(made(tmp_path / "pixels", 3), tmp_path / "out")
    with pytest.raises(RacinesError, match="has no times"):
        release(made(tmp_path / "metres", 3, pixel_mm=0.8), tmp_path / "out")
    assert not (tmp_path / "out").exists()
