import csv
import shutil
from pathlib import Path

import datasets
import numpy as np
import pytest
from PIL import Image

from racines_data import RacinesError, open_store
from racines_data.build.dataset import DataConfig, build
from racines_data.records import check_trajectory
from racines_data.sources.cactus.source import CactusSource, sector_box
from racines_data.sources.images import Kind
from racines_data.validate.run import validate
from racines_data.views import LABELS
from tests.data.pipes import fifo

PER_VIEW = 12
WIDTH, HEIGHT = 320, 240
BOX = 90, 30, 230, 200
"""The sector on the made-up screen."""


def screen(rng: np.random.Generator) -> np.ndarray:
    """Return a scanner's screen: a speckled sector, a bright logo, a depth scale, black."""
    image = np.zeros((HEIGHT, WIDTH), np.uint8)
    left, top, right, bottom = BOX
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    sector = (y >= top) & (y < bottom) & (x >= left) & (x < right)
    sector &= np.abs(x - (left + right - 1) / 2) <= 4 + (y - top)
    image[sector] = rng.integers(20, 255, sector.sum(), np.uint8)
    image[10:24, 5:70] = 230
    image[30:200:10, 300:310] = 200
    return image


def grade_of(view: str, number: int) -> int:
    return 0 if view == "Random" else 1 + number % 10


def write_cactus(root: Path, views=LABELS) -> Path:
    """Write a tree like CACTUS: made-up images, no real one."""
    for place, view in enumerate(views):
        folder = root / "Images Dataset" / view
        folder.mkdir(parents=True)
        rows = []
        for number in range(PER_VIEW):
            name = f"{grade_of(view, number)}_{view}_{number:03d}.jpg"
            rng = np.random.default_rng([place, number])
            Image.fromarray(screen(rng)).save(folder / name, quality=95)
            rows.append([name, view, grade_of(view, number)])
        write_table(root, view, rows)
    return root


def write_table(root: Path, view: str, rows: list[list]) -> None:
    (root / "Grades").mkdir(exist_ok=True)
    with (root / "Grades" / f"{view}_grades.csv").open("w", newline="") as file:
        csv.writer(file).writerows([["Image Name", "Subfolder Name", "Grade"], *rows])


def rows_of(root: Path, view: str) -> list[list[str]]:
    with (root / "Grades" / f"{view}_grades.csv").open(newline="") as file:
        return list(csv.reader(file))[1:]


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    return write_cactus(tmp_path / "cactus")


def source(root: Path, **settings) -> CactusSource:
    return CactusSource.from_config(settings, [root])


def reasons(made: CactusSource) -> list[tuple[str, bool, str]]:
    return [(f.reason.partition(":")[0], f.refused, f.file + f.item) for f in made.report]


@pytest.mark.usefixtures("warm_workers")
def test_a_dataset_of_labels_and_grades_without_poses(tree: Path, tmp_path: Path):
    root = tmp_path / "racines"
    manifest = build(source(tree, run=4), root, DataConfig(workers=2, shards=2))
    assert manifest["counts"]["frames"] == 6 * PER_VIEW and manifest["poses"] is False
    result = validate(root)
    assert result.ok, [check for check in result.checks if not check.ok]
    assert result.statistics == {}
    rows = datasets.concatenate_datasets(list(datasets.load_dataset(str(root)).values()))
    assert len(rows) == 6 * PER_VIEW and set(rows["position_x"]) == {None}
    assert set(rows["timestamp"]) == {None} and set(rows["force_z"]) == {None}
    names = rows.features["view"].int2str(rows["view"][:])
    assert names == rows["target_view"][:] and set(names) == set(LABELS)
    grades = np.array(rows["grade"][:])
    assert np.array_equal(np.array(names) == "Random", grades == 0)
    store = open_store(root)
    assert store.parameters.isnan().all() and store.timestamps.isnan().all()
    assert store.images.float().std() > 20
    sweeps = datasets.load_dataset(str(root), "trajectories", split="train")
    assert set(sweeps["duration"]) == {None}


def test_grades_and_views_are_those_of_the_tables(tree: Path):
    made = source(tree)
    for unit in made.plan():
        trajectory = made.produce(unit)
        assert [p.grade for p in unit.pictures] == [
            grade_of(unit.target_view, n) for n in range(12)
        ]
        assert np.array_equal(trajectory.grades, [p.grade for p in unit.pictures])
        assert set(trajectory.views) == {LABELS.index(unit.target_view)}
    assert made.report == []


def test_no_fifo_is_waited_for_and_no_link_out_followed(tree: Path, tmp_path: Path):
    image = next((tree / "Images Dataset" / "SC").glob("*.jpg"))
    grades, aside = tree / "Grades" / "SC_grades.csv", tmp_path / "aside"
    for place in (image, grades):
        shutil.copy(place, aside)
        place.unlink()
        place.symlink_to(aside)
        assert f"a link out of the folder, to {aside}: put" in refused(tree, place)
        with fifo(place):
            assert "a FIFO, a socket or a device, where a file is" in refused(tree, place)
        shutil.copy(aside, place)


def refused(root: Path, place: Path) -> str:
    """Return why a file is refused: alone, or with the whole folder where it has the grades."""
    made = source(root)
    if place.suffix == ".csv":
        with pytest.raises(RacinesError, match=f"grades: Grades/{place.name}: ") as caught:
            made.plan()
        return str(caught.value)
    assert sum(unit.frames for unit in made.plan()) == 6 * PER_VIEW - 1
    (finding,) = made.report
    assert finding.refused and finding.file == place.relative_to(root).as_posix()
    return finding.reason.removeprefix("unreadable image: ")


def test_runs_are_contiguous_and_stay_in_their_folder(tree: Path):
    folder = tree / "Images Dataset" / "SC" / "second"
    folder.mkdir()
    for path in sorted(folder.parent.glob("*.jpg"))[::2]:
        shutil.move(path, folder / path.name)
    made = source(tree, run=5)
    units = [unit for unit in made.plan() if unit.target_view == "SC"]
    assert [unit.frames for unit in units] == [3, 3, 3, 3] and made.report == []
    for unit in units:
        assert len({picture.subfolder for picture in unit.pictures}) == 1
        numbers = [int(picture.file[-7:-4]) for picture in unit.pictures]
        assert numbers == sorted(numbers)
    assert [unit.id for unit in units] == ["sc-000", "sc-001", "sc-002", "sc-003"]


def test_borders_are_cropped_alike_in_all_views(tree: Path):
    made = source(tree)
    units = made.plan()
    ((size, box),) = units[0].boxes
    assert size == (WIDTH, HEIGHT) and all(unit.boxes == units[0].boxes for unit in units)
    assert np.abs(np.subtract(box, BOX)).max() <= 3
    image = made.produce(units[0]).images[0]
    rows, columns = np.nonzero(image > 60)
    assert rows.min() <= 3 and rows.max() >= 100 and 55 < columns.mean() < 72
    whole = source(tree, crop="none")
    assert whole.plan()[0].boxes == (((WIDTH, HEIGHT), (0, 0, WIDTH, HEIGHT)),)
    given = source(tree, crop="90,30,230,200")
    assert given.plan()[0].boxes[0][1] == BOX
    with pytest.raises(RacinesError, match="320×240 pixels only"):
        source(tree, crop="0,0,400,200").plan()
    for crop in ("left", "9,9,3,12"):
        with pytest.raises(RacinesError, match="data.cactus.crop .*: give auto, none, or left"):
            source(tree, crop=crop)


def test_box_of_few_or_empty_screens():
    rng = np.random.default_rng(0)
    plain = screen(rng)
    plain[10:24, 5:70] = 0
    assert np.abs(np.subtract(sector_box([plain]), BOX)).max() <= 8
    assert sector_box([np.zeros((HEIGHT, WIDTH), np.uint8)] * 10) == (0, 0, WIDTH, HEIGHT)


def test_two_sizes_are_flagged_and_cropped_each(tree: Path):
    path = tree / "Images Dataset" / "PL" / "1_PL_000.jpg"
    image = Image.open(path)
    image.resize((640, 480)).save(path, quality=95)
    made = source(tree)
    assert len(made.plan()[0].boxes) == 2
    assert reasons(made) == [("mixed sizes", False, "Images Dataset/PL/1_PL_000.jpg")]


def test_damaged_images_are_refused(tree: Path):
    folder = tree / "Images Dataset" / "PL"
    first, second, third = sorted(folder.glob("*.jpg"))[:3]
    first.write_bytes(first.read_bytes()[:3000])
    Image.new("L", (WIDTH, HEIGHT)).save(second, "PNG")
    third.write_bytes(b"")
    made = source(tree)
    assert sum(unit.frames for unit in made.plan()) == 6 * PER_VIEW - 3
    kinds = {file: kind for kind, _, file in reasons(made)}
    assert kinds == {
        f"Images Dataset/PL/{first.name}": "truncated JPEG",
        f"Images Dataset/PL/{second.name}": "not a JPEG",
        f"Images Dataset/PL/{third.name}": "truncated JPEG",
    }
    assert all(finding.refused for finding in made.report)


def test_what_tables_and_names_disagree_on_is_told(tree: Path):
    rows = rows_of(tree, "A4C")
    rows[2][2] = "9"  # the name says 3
    rows[3][2] = "11"
    del rows[5]
    rows.append(["5_A4C_999.jpg", "A4C", "5"])
    write_table(tree, "A4C", rows)
    table = rows_of(tree, "Random")
    path = tree / "Images Dataset" / "Random"
    (path / table[0][0]).rename(path / "4_Random_000.jpg")
    write_table(tree, "Random", [["4_Random_000.jpg", "Random", "4"], *table[1:]])
    made = source(tree)
    units = {unit.target_view: unit for unit in made.plan()}
    base = "Images Dataset/A4C"
    assert reasons(made) == [
        ("grade conflict", False, f"{base}/3_A4C_002.jpgGrade"),
        ("grade conflict", False, f"{base}/4_A4C_003.jpgGrade"),
        ("missing row", False, f"{base}/6_A4C_005.jpg"),
        ("missing image", True, "Grades/A4C_grades.csv5_A4C_999.jpg"),
        ("wrong grade", False, "Images Dataset/Random/4_Random_000.jpgGrade"),
    ]
    grades = made.produce(units["A4C"]).grades
    assert np.isnan(grades[[2, 3]]).all() and grades[5] == 6 and np.isfinite(grades).sum() == 10
    assert np.isnan(made.produce(units["Random"]).grades[0])


def test_names_without_a_grade_take_the_tables(tree: Path):
    folder = tree / "Images Dataset" / "SC"
    rows = rows_of(tree, "SC")
    for row in rows:
        renamed = row[0].partition("_")[2]
        (folder / row[0]).rename(folder / renamed)
        row[0] = renamed.removesuffix(".jpg").upper()
    write_table(tree, "SC", rows)
    made = source(tree)
    units = {unit.target_view: unit for unit in made.plan()}
    assert made.report == []
    assert [p.grade for p in units["SC"].pictures] == [grade_of("SC", n) for n in range(PER_VIEW)]


def test_case_litter_and_missing_tables(tree: Path):
    (tree / "Images Dataset" / "PSAV").rename(tree / "Images Dataset" / "psav")
    (tree / "Grades" / "PSAV_grades.csv").rename(tree / "Grades" / "psav_Grades.CSV")
    (tree / "Images Dataset" / "SC" / "Thumbs.db").touch()
    (tree / "Images Dataset" / "SC" / "notes.txt").touch()
    (tree / "Images Dataset" / "A5C").mkdir()
    (tree / "Grades" / "PL_grades.csv").unlink()
    made = source(tree)
    assert sum(unit.frames for unit in made.plan()) == 6 * PER_VIEW
    assert sorted(reasons(made)) == [
        ("missing table", False, "Grades/PL_grades.csv"),
        ("unknown file", False, "Images Dataset/A5C"),
        ("unknown file", False, "Images Dataset/SC/notes.txt"),
    ]


def test_what_is_not_cactus_is_refused(tree: Path, tmp_path: Path):
    with pytest.raises(RacinesError, match="holds no folder `Images Dataset`"):
        source(tmp_path).plan()
    with pytest.raises(RacinesError, match="name one folder"):
        CactusSource.from_config({}, [])
    with pytest.raises(RacinesError, match="data.cactus.run: give one or more"):
        source(tree, run=0)
    (tree / "Grades" / "PL_grades.csv").write_text("a,b\n1,2\n")
    with pytest.raises(RacinesError, match="PL_grades.csv: has no column 'Image Name'"):
        source(tree).plan()
    shutil.rmtree(tree / "Images Dataset")
    (tree / "Images Dataset" / "SC").mkdir(parents=True)
    with pytest.raises(RacinesError, match="holds no image of a view"):
        source(tree).plan()


def test_poses_are_all_or_nothing(tree: Path):
    made = source(tree)
    unit = made.plan()[0]
    trajectory = made.produce(unit)
    with pytest.raises(RacinesError, match="position_x of frame 0 is not finite"):
        check_trajectory(trajectory, unit)
    check_trajectory(trajectory, unit, poses=False)
    trajectory.parameters[0, 6] = 0.5
    with pytest.raises(RacinesError, match="has poses or times, but its source says"):
        check_trajectory(trajectory, unit, poses=False)


def test_recipe_knows_bytes_grades_and_no_path(tree: Path, tmp_path: Path):
    moved = shutil.copytree(tree, tmp_path / "moved")
    assert source(tree).recipe() == source(moved).recipe()
    rows = rows_of(moved, "SC")
    rows[0][2] = "8"
    write_table(moved, "SC", rows)
    assert source(tree).recipe() != source(moved).recipe()


def test_every_kind_is_explained():
    text = (Path(__file__).parents[3] / "docs" / "import.md").read_text()
    assert all(f"| {kind} |" in text for kind in Kind)
