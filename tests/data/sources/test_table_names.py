"""The source `table`: what stands in a column or a file's name is taken to the letter."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from PIL import Image

from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.sources.images import square
from racines_data.sources.table.rows import read_table
from tests.data.sources.table_folder import (
    ROBOT,
    changed,
    columns_of,
    source,
    sweep,
    synthetic,
    synthetic_folder,
    write_folder,
)


def of_sweeps(folder: Path, names: list[str], places: list[str]) -> np.ndarray:
    """Write a sweep a name, whose images lie in a folder of its own; return (S, T, …) images."""
    poses, times, _ = synthetic()
    images = np.random.default_rng(3).integers(0, 256, (len(names), len(times), 48, 64), np.uint8)
    tables = []
    for name, place, own in zip(names, places, images, strict=True):
        (folder / place).mkdir(parents=True)
        for row, image in enumerate(own):
            Image.fromarray(image).save(folder / place / f"{row:04d}.png", compress_level=1)
        tables.append(pl.DataFrame({"sweep": [name] * len(own), **columns_of(poses, times)}))
    pl.concat(tables).write_csv(folder / "poses.csv")
    return images


@pytest.mark.parametrize("name", ["run[1]", "run[12]", "run?", "r*"])
def test_a_sweeps_name_is_no_pattern(tmp_path: Path, name: str):
    names = [name, "run1"]
    images = of_sweeps(tmp_path, names, names)
    made = source(tmp_path, changed(ROBOT, poses__sweep="sweep", images__path="{sweep}/*.png"))
    units = made.plan()
    assert not made.report and len(units) == 2
    for unit, own in zip(units, images, strict=True):
        assert np.array_equal(made.produce(unit).images, np.stack([square(each) for each in own]))


@pytest.mark.parametrize("template", ["{sweep}/{row:04d}.png", "{sweep:03d}/{row:04d}.png"])
def test_zeros_before_a_number_belong_to_a_name(tmp_path: Path, template: str):
    images = of_sweeps(tmp_path, ["001", "002"], ["001", "002"])
    made = source(tmp_path, changed(ROBOT, poses__sweep="sweep", images__path=template))
    units = made.plan()
    assert not made.report and [unit.id for unit in units] == ["001", "002"]
    assert np.array_equal(made.produce(units[1]).images[3], square(images[1, 3]))


def test_columns_with_zeros_before_them_are_numbers_still(tmp_path: Path):
    (tmp_path / "t.csv").write_text("a,b,c\n007,1,1.5\n10,2,02.5\n")
    table = read_table(tmp_path / "t.csv", None, False, None)
    assert table["a"].to_list() == ["007", "10"] and table["b"].to_list() == [1, 2]
    assert table["c"].to_list() == [1.5, 2.5]
    plain = sweep(synthetic_folder(tmp_path / "plain"), ROBOT)
    poses, times, images = synthetic()
    columns = columns_of(poses, times)
    padded = [f"{round(value * 1000):07d}" for value in times]
    write_folder(tmp_path / "padded", {**columns, "t": padded}, images)
    mapping = changed(ROBOT, poses__time={"column": "t", "unit": "ms"})
    assert np.abs(sweep(tmp_path / "padded", mapping).timestamps - plain.timestamps).max() < 1e-6


@pytest.mark.parametrize("mark", [",", ";", "\t", " "])
def test_spaces_in_a_head_are_no_separator_beside_another(tmp_path: Path, mark: str):
    names = ["time", "x"] if mark == " " else ["time [s]", "pos x [mm]", "a b c d"]
    rows = [names, ["1.0"] * len(names), ["2.0"] * len(names)]
    (tmp_path / "t.csv").write_text("\n".join(mark.join(row) for row in rows) + "\n")
    assert read_table(tmp_path / "t.csv", None, False, None).columns == names


@pytest.mark.parametrize("view", ["../../EVIL", "2C/4C", "a\\b", "..", "x\x07"])
def test_a_view_that_cannot_name_a_file_is_refused(tmp_path: Path, view: str):
    folder = synthetic_folder(tmp_path / "in")
    with pytest.raises(RacinesError, match=r"labels\.views: .* is no name of a view"):
        source(folder, changed(ROBOT, labels__views=[view, "PLAX"]))


@pytest.mark.parametrize(
    "view, grade, said",
    [
        ("", 7.0, "graded, of unknown view"),
        ("A4C", 0.5, "of a view, graded outside 1-10"),
        ("Random", 3.0, "Random, yet graded"),
    ],
)
def test_labels_that_would_not_validate_are_not_imported(tmp_path, view, grade, said):
    count = len(synthetic()[1])
    folder = synthetic_folder(tmp_path / "in", view=[view] * count, grade=[grade] * count)
    mapping = changed(ROBOT, segments=3, labels={"view": "view", "grade": "grade"})
    made = source(folder, mapping)
    with pytest.raises(RacinesError, match=f"labels.grade: row 0 is {said}: give its view"):
        build(made, tmp_path / "out", DataConfig(source="table", workers=1, strict=True))
