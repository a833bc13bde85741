"""Wrong mappings of real tracked sweeps: each is refused, and its mistake called by its name."""

import json
import shutil
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.sources.table import TableSource
from racines_data.sources.tracked.source import read_header
from tests.data.sources.table_folder import (
    EULER,
    MATRICES,
    MATRIX,
    QUATERNION,
    QUATERNIONS,
    ROBOT,
    changed,
    columns_of,
    synthetic,
    synthetic_folder,
    write_mapping,
    write_recording,
)
from tests.data.sources.test_tracked import NWIRE, SPINE, needs_real

ROOT = Path(__file__).parents[3]
BY_COLUMNS = [f"m{i}{j}" for j in range(4) for i in range(4)]
ROTATION = [f"m{i}{j}" for i in range(3) for j in range(3)]
EULERS = changed(QUATERNIONS, poses__rotation=EULER)
NINE = changed(
    MATRICES,
    poses__position={"columns": ["x", "y", "z"], "unit": "mm"},
    poses__rotation={"kind": "matrix", "columns": ROTATION},
)
MISREAD = changed(QUATERNIONS, poses__position={"columns": ["cx", "cy", "cz"], "unit": "cm"})
"""The right mapping of the positions in centimetres."""
WRONG = {
    "metres for millimetres": (changed(QUATERNIONS, poses__position__unit="m"), "millimetres"),
    "centimetres taken for metres": (changed(MISREAD, poses__position__unit="m"), ": centimetres:"),
    "metres in a matrix": (changed(MATRICES, poses__rotation__unit="m"), "millimetres"),
    "degrees for radians": (changed(EULERS, poses__rotation__unit="deg"), "radians"),
    "degrees taken for radians": (
        changed(EULERS, poses__rotation__columns=["dx", "dy", "dz"]),
        ": degrees:",
    ),
    "order of angles": (changed(EULERS, poses__rotation__order="zyx"), "order of angles"),
    "w last": (changed(QUATERNIONS, poses__rotation__order="xyzw"), "w first"),
    "quaternion listed otherwise": (
        changed(QUATERNIONS, poses__rotation__columns=["qx", "qy", "qz", "qw"]),
        "w last",
    ),
    "position for quaternion": (
        changed(QUATERNIONS, poses__rotation__columns=["x", "y", "z", "qw"]),
        "no quaternion",
    ),
    "a number of a quaternion in a matrix": (
        changed(NINE, poses__rotation__columns=["qw", *ROTATION[1:]]),
        "no rotation",
    ),
    "last row of a matrix first": (
        changed(MATRICES, poses__rotation__columns=MATRIX[12:] + MATRIX[:12]),
        "no rigid pose",
    ),
    "matrix by columns": (changed(MATRICES, poses__rotation__layout="columns"), "transposed"),
    "columns of a matrix swapped": (
        changed(MATRICES, poses__rotation__columns=BY_COLUMNS),
        "transposed",
    ),
    "rotation alone transposed": (changed(NINE, poses__rotation__layout="columns"), "transposed"),
    "rows of a matrix swapped": (
        changed(MATRICES, poses__rotation__columns=MATRIX[4:8] + MATRIX[:4] + MATRIX[8:]),
        "mirrored",
    ),
    "axes swapped": (
        changed(QUATERNIONS, poses__position__columns=["y", "x", "z"]),
        "swapped columns",
    ),
    "seconds for milliseconds": (changed(QUATERNIONS, poses__time__unit="ms"), ": seconds:"),
    "seconds for nanoseconds": (changed(QUATERNIONS, poses__time__unit="ns"), ": seconds:"),
    "milliseconds taken for seconds": (
        changed(QUATERNIONS, poses__time__column="millis"),
        ": milliseconds:",
    ),
    "microseconds taken for seconds": (
        changed(QUATERNIONS, poses__time__column="micros"),
        ": microseconds:",
    ),
    "a clock that stands": (changed(QUATERNIONS, poses__time__column="still"), "frozen clock"),
    "frame numbers for times": (
        changed(QUATERNIONS, poses__time__column="number"),
        "frame numbers for times",
    ),
    "a counter for a position": (
        changed(QUATERNIONS, poses__position__columns=["number", "y", "z"]),
        "a counter for a position",
    ),
    "position for time": (changed(QUATERNIONS, poses__time__column="x"), "one column twice"),
    "a robot's frame": (changed(QUATERNIONS, frame="robot"), "looks up"),
    "inverted": (changed(QUATERNIONS, poses__invert=True), "inverted"),
    "one image for all": (changed(QUATERNIONS, images__path="frames/0.png"), "missing frames"),
    "one image for four rows": (changed(QUATERNIONS, images__path="{shown}"), "frozen frames"),
    "images half": (changed(QUATERNIONS, images__path="frames/?.png"), "missing frames"),
    "calibration in pixels": (
        changed(
            QUATERNIONS,
            calibration__image_to_probe=np.diag([0.2, 0.2, 0.2, 1.0]).tolist(),
        ),
        "if it maps pixels, set image_scaled",
    ),
    "calibration mirrored": (
        changed(
            QUATERNIONS,
            calibration__image_to_probe=np.diag([1.0, -1.0, 1.0, 1.0]).tolist(),
        ),
        "reflected rotation",
    ),
    "crop beyond the image": (changed(QUATERNIONS, images__crop=[0, 0, 5000, 100]), "images.crop"),
}


def misread(folder: Path) -> Path:
    """Add columns that a hurried mapping takes for others; their names say nothing of units."""
    table, row = pl.read_csv(folder / "poses.csv"), pl.int_range(pl.len())
    table.with_columns(
        *(pl.col(axis).alias(f"c{axis}") / 10 for axis in "xyz"),
        *(pl.col(f"r{axis}").degrees().alias(f"d{axis}") for axis in "xyz"),
        millis=pl.col("t") * 1e3,
        micros=pl.col("t") * 1e6,
        still=pl.col("t").first(),
        number=row,
        shown=pl.format("frames/{}.png", row // 4),
    ).write_csv(folder / "poses.csv")
    return folder


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    made = tmp_path_factory.mktemp("sweeps")
    return {
        path.name[:5]: misread(write_recording(made / path.name[:5], read_header(path), small=True))
        for path in (SPINE, NWIRE)
    }


def refusal(folder: Path, mapping: dict, out: Path) -> str:
    write_mapping(folder, mapping)
    with pytest.raises(RacinesError) as caught:
        build(TableSource.from_config({}, [folder]), out, DataConfig(source="table", workers=1))
    assert not out.exists()
    return str(caught.value)


FAR = {"inverted", "a robot's frame"}
"""What only the sweep seen from two metres away tells: of the other both are plausible."""


@needs_real
@pytest.mark.parametrize("sweep", ["Nwire", "Spine"])
@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_mapping_is_called_by_name(
    folders: dict[str, Path], tmp_path: Path, wrong: str, sweep: str
):
    mapping, name = WRONG[wrong]
    if sweep == "Spine" and wrong in FAR:
        write_mapping(folders[sweep], mapping)
        assert TableSource.from_config({}, [folders[sweep]]).plan()
        return
    told = refusal(folders[sweep], mapping, tmp_path / "out")
    assert name in told.split(" (also")[0], told


@needs_real
@pytest.mark.parametrize("sweep", ["Nwire", "Spine"])
def test_a_tracker_does_not_tell_centimetres_from_millimetres(folders: dict[str, Path], sweep: str):
    """The limit that docs/table.md states: a sweep ten times too small is a plausible one."""
    for mapping in (MISREAD, changed(MISREAD, poses__position__unit="mm")):
        write_mapping(folders[sweep], mapping)
        assert TableSource.from_config({}, [folders[sweep]]).plan()


@pytest.mark.parametrize(
    ("truth", "unit", "told"),
    [("cm", "mm", "centimetres"), ("m", "cm", "metres"), ("m", "mm", "metres")],
)
def test_no_probe_is_within_a_robots_base(tmp_path: Path, truth: str, unit: str, told: str):
    poses, times, _ = synthetic()
    poses[:, :3, 3] /= {"cm": 10, "m": 1000}[truth]
    folder = synthetic_folder(tmp_path / "mine", **columns_of(poses, times))
    assert f": {told}: the probe is 0.0" in refusal(
        folder, changed(ROBOT, poses__position__unit=unit), tmp_path / "out"
    )
    write_mapping(folder, changed(ROBOT, poses__position__unit=truth))
    assert TableSource.from_config({}, [folder]).plan()


def test_the_documented_number_of_wrong_mappings_is_theirs():
    figures = json.loads((ROOT / "docs/results/table.json").read_text())["figures"]
    assert figures["wrong"] == len(WRONG)
    assert f"one of {len(WRONG)} wrong mappings" in (ROOT / "docs/trust.md").read_text()


@needs_real
def test_what_names_do_not_tell_motion_does(folders: dict[str, Path], tmp_path: Path):
    """The sweep that turns by 7 degrees: of its columns, no name says which is w, or r12."""
    folder = tmp_path / "Nwire"
    shutil.copytree(folders["Nwire"], folder)
    table = pl.read_csv(folder / "poses.csv")
    table = table[:, : table.columns.index("image") + 1]
    table = table.rename({name: f"c{i:02d}" for i, name in enumerate(table.columns[:-1])})
    table.write_csv(folder / "poses.csv")
    names = dict(zip(("t", "x", "y", "z", *MATRIX, *QUATERNION), table.columns, strict=False))
    own = {
        "poses__time__column": names["t"],
        "poses__position__columns": [names[axis] for axis in "xyz"],
        "poses__rotation__columns": [names[each] for each in QUATERNION],
    }
    told = refusal(
        folder, changed(QUATERNIONS, **own, poses__rotation__order="xyzw"), tmp_path / "o"
    )
    assert "poses.rotation.order: w first: turning about a point explains 9" in told
    write_mapping(folder, changed(QUATERNIONS, **own))
    assert TableSource.from_config({}, [folder]).plan(), "the right one passes"
    write_mapping(folder, changed(QUATERNIONS, **own, poses__rotation__order="xyzw"))
    assert TableSource.from_config({"allow": ["reading"]}, [folder]).plan()
