import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import datasets
import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from PIL import Image

from racines_data import RacinesError, open_store
from racines_data.build import DataConfig, build
from racines_data.geometry import geodesic, parameters_to_pose
from racines_data.sources import Finding, source_class
from racines_data.sources.images import square
from racines_data.sources.release import ReleaseSource
from racines_data.sources.release_log import parse_log
from racines_data.validate import validate
from tests.conftest import ROOT
from tests.data.release_tree import (
    FRAMES,
    log_text,
    read_elsewhere,
    write_frames,
    write_release,
)

IMAGES, LOGS = "Folder 1/A4C/images", "Folder 1/A4C/logs"
TOTAL = 5 * FRAMES


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    return write_release(tmp_path / "release")


def source(root: Path, **settings) -> ReleaseSource:
    return ReleaseSource.from_config(settings, [root])


def planned(root: Path, **settings) -> tuple[int, list[Finding]]:
    made = source(root, **settings)
    return sum(unit.frames for unit in made.plan()), made.report


def change(root: Path, number: int, **parts) -> None:
    """Replace parts of a log of the first recording."""
    path = root / LOGS / f"PA_{number}.txt"
    row = np.array(parse_log(path.read_text()))
    fields = {"time": row[0], "wrench": row[1:7], "pose": row[7:23].reshape(4, 4)}
    fields |= {"control": row[23:29]}
    path.write_text(log_text(**(fields | parts)))


def pose_of(root: Path, number: int) -> np.ndarray:
    text = (root / LOGS / f"PA_{number}.txt").read_text()
    return np.array(parse_log(text))[7:23].reshape(4, 4)


def test_recordings_become_trajectories(tree: Path):
    made = source(tree)
    units = made.plan()
    assert [(unit.id, unit.session, unit.target_view, unit.frames) for unit in units] == [
        ("folder-1-a4c", "folder-1", "A4C", FRAMES),
        ("folder-1-sc-1", "folder-1", "SC", FRAMES),
        ("folder-1-sc-2", "folder-1", "SC", FRAMES),
        ("folder-2-full", "folder-2", "Random", FRAMES),
        ("folder-3-full-part2", "folder-3", "Random", FRAMES),
    ]
    assert made.report == [] and made.plan() == units
    assert source_class("release") is ReleaseSource


def test_frames_are_what_the_files_say(tree: Path):
    """Compare with a reader that shares no code with the importer."""
    made = source(tree)
    trajectories = [made.produce(unit) for unit in pickle.loads(pickle.dumps(made)).plan()]
    expected = read_elsewhere(tree)
    assert len(expected) == TOTAL
    images = np.concatenate([t.images for t in trajectories])
    assert np.array_equal(images, [frame["image"] for frame in expected])
    parameters = torch.from_numpy(np.concatenate([t.parameters for t in trajectories]))
    assert np.allclose(parameters[:, :6], [f["wrench"] for f in expected], atol=1e-6)
    position, rotation = parameters_to_pose(parameters.double())
    poses = torch.tensor(np.array([frame["pose"] for frame in expected]))
    assert torch.allclose(position, poses[:, :3, 3], atol=1e-7)
    assert float(geodesic(rotation, poses[:, :3, :3]).max()) < 1e-6
    assert np.array_equal(
        np.concatenate([t.timestamps for t in trajectories]), [f["time"] for f in expected]
    )
    controls = np.concatenate([t.controls for t in trajectories])
    assert np.allclose(controls, [frame["control"] for frame in expected])
    assert all((t.views == -1).all() and np.isnan(t.grades).all() for t in trajectories)


def test_the_dataset_is_valid_and_loads(tree: Path, tmp_path: Path):
    root = tmp_path / "racines"
    manifest = build(source(tree), root, DataConfig(workers=1, shards=2))
    assert manifest["counts"]["sessions"] == {"folder-1": 24, "folder-2": 8, "folder-3": 8}
    assert manifest["held_out_session"] == "folder-3" and manifest["source"] == "release"
    result = validate(root)
    assert result.ok, [check for check in result.checks if not check.ok]
    loaded = datasets.load_dataset(str(root))
    rows = datasets.concatenate_datasets(list(loaded.values()))
    assert len(rows) == TOTAL and rows[0]["image"].size == (128, 128)
    assert set(rows["view"]) == {None} and set(rows["grade"]) == {None}
    assert set(rows["target_view"]) == {"A4C", "SC", "Random"}
    assert len(open_store(root)) == TOTAL


def test_folders_as_views_are_a_choice(tree: Path):
    made = source(tree, label_views=True)
    labels = [set(made.produce(unit).views.tolist()) for unit in made.plan()]
    assert labels == [{0}, {1}, {1}, {5}, {5}]


def test_names_vary_in_case_and_numbers_count_as_numbers(tmp_path: Path):
    write_frames(tmp_path / "folder_1/psav/Images_2", tmp_path / "folder_1/psav/Logs_2", 1, (9, 10))
    made = source(tmp_path)
    (unit,) = made.plan()
    assert (unit.id, unit.target_view) == ("folder-1-psav-2", "PSAV")
    assert [pair.number for pair in unit.pairs] == [9, 10] and made.report == []


@pytest.mark.parametrize("mode", ["L", "RGB", "RGBA", "P"])
@pytest.mark.parametrize("size", [(128, 128), (200, 160)])
def test_other_images_become_128_gray(tmp_path: Path, mode: str, size: tuple[int, int]):
    write_frames(tmp_path / IMAGES, tmp_path / LOGS, 1, range(2), size)
    path = tmp_path / IMAGES / "img0.png"
    gray = np.asarray(Image.open(path))
    for number in range(2):
        file = tmp_path / IMAGES / f"img{number}.png"
        Image.open(file).convert("RGB" if mode == "RGBA" else mode).convert(mode).save(file)
    made = source(tmp_path)
    image = made.produce(made.plan()[0]).images[0]
    assert made.report == [] and image.shape == (128, 128)
    assert np.array_equal(image, square(gray))
    assert size != (128, 128) or np.array_equal(image, gray)


def test_sixteen_bits_are_refused(tree: Path):
    Image.fromarray(np.full((128, 128), 4000, np.uint16)).save(tree / IMAGES / "img2.png")
    frames, (finding,) = planned(tree)
    assert frames == TOTAL - 1 and finding.reason.startswith("unreadable image: 16 bits")


def missing_log(root: Path) -> None:
    (root / LOGS / "PA_3.txt").unlink()


def missing_image(root: Path) -> None:
    (root / IMAGES / "img3.png").unlink()


def truncated(root: Path) -> None:
    path = root / IMAGES / "img3.png"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def not_a_png(root: Path) -> None:
    Image.new("L", (128, 128)).save(root / IMAGES / "img3.png", "JPEG")


def nan(root: Path) -> None:
    change(root, 3, wrench=[1, 2, np.nan, 4, 5, 6])


def infinite(root: Path) -> None:
    change(root, 3, pose=pose_of(root, 3) + np.diag([0, 0, np.inf, 0]))


def reflected(root: Path) -> None:
    change(root, 3, pose=pose_of(root, 3) @ np.diag([1, 1, -1, 1]))


def sheared(root: Path) -> None:
    change(root, 3, pose=pose_of(root, 3) @ np.diag([1, 1.01, 1, 1]))


def millimetres(root: Path) -> None:
    change(root, 3, pose=np.diag([1000, 1000, 1000, 1]) @ pose_of(root, 3))
    pose = pose_of(root, 3)
    pose[:3, :3] /= 1000
    change(root, 3, pose=pose)


def duplicate(root: Path) -> None:
    shutil.copy(root / IMAGES / "img4.png", root / IMAGES / "img03.png")


def gap(root: Path) -> None:
    missing_image(root)
    missing_log(root)


def empty(root: Path) -> None:
    (root / "Folder 2/PL/images").mkdir(parents=True)
    (root / "Folder 2/PL/logs").mkdir(parents=True)


def wrong_shape(root: Path) -> None:
    change(root, 3, pose=pose_of(root, 3)[:3])


DAMAGE: dict[str, tuple[Callable[[Path], None], int, str]] = {
    "missing log": (missing_log, 1, f"{IMAGES}/img3.png"),
    "missing image": (missing_image, 1, f"{LOGS}/PA_3.txt"),
    "truncated PNG": (truncated, 1, f"{IMAGES}/img3.png"),
    "not a PNG": (not_a_png, 1, f"{IMAGES}/img3.png"),
    "NaN": (nan, 1, f"{LOGS}/PA_3.txt"),
    "infinite": (infinite, 1, f"{LOGS}/PA_3.txt"),
    "reflected rotation": (reflected, 1, f"{LOGS}/PA_3.txt"),
    "non-orthonormal rotation": (sheared, 1, f"{LOGS}/PA_3.txt"),
    "millimetres": (millimetres, 1, f"{LOGS}/PA_3.txt"),
    "duplicate number": (duplicate, 1, f"{IMAGES}/img3.png"),
    "gap in numbers": (gap, 1, IMAGES),
    "empty folder": (empty, 0, "Folder 2/PL/images"),
    "wrong matrix shape": (wrong_shape, 1, f"{LOGS}/PA_3.txt"),
}
"""Kind: how it comes about, frames that are lost, the file that is reported first."""


@pytest.mark.parametrize("kind", DAMAGE)
def test_damage_is_named_and_good_frames_are_kept(tree: Path, kind: str):
    whole = source(tree)
    before = whole.produce(whole.plan()[0])
    harm, lost, file = DAMAGE[kind]
    harm(tree)
    made = source(tree)
    units = made.plan()
    assert sum(unit.frames for unit in units) == TOTAL - lost
    assert {finding.reason.partition(":")[0] for finding in made.report} == {kind}
    assert made.report[0].file == file
    assert made.report[0].refused == (kind != "gap in numbers")
    assert sum(finding.frames for finding in made.report if finding.refused) == (
        0 if kind == "gap in numbers" else lost
    )
    after = made.produce(units[0])
    kept = [index for index in range(FRAMES) if not (lost and index == 3)]
    assert np.array_equal(after.images, before.images[kept])
    assert np.array_equal(after.parameters, before.parameters[kept])


def test_all_damage_at_once_stands_in_the_report(tmp_path: Path):
    tree = tmp_path / "release"
    for index, harm in enumerate(harm for harm, _, _ in DAMAGE.values()):
        part = write_release(tmp_path / f"part{index}", 100 * index)
        harm(part)
        shutil.copytree(part / "Folder 1/A4C", tree / f"Folder {index + 1}/A4C")
        if (part / "Folder 2/PL").exists():
            shutil.copytree(part / "Folder 2/PL", tree / f"Folder {index + 1}/PL")
    root = tmp_path / "racines"
    manifest = build(source(tree), root, DataConfig(workers=1))
    rows = pq.read_table(root / "import_report.parquet").to_pylist()
    assert {row["reason"].partition(":")[0] for row in rows} == set(DAMAGE)
    assert all(row["file"] and row["reason"].partition(": ")[2] for row in rows)
    assert manifest["report"]["refused_frames"] == 11
    assert manifest["counts"]["frames"] == 13 * FRAMES - 12
    result = validate(root)
    assert result.ok, [check for check in result.checks if not check.ok]


@pytest.mark.parametrize("kind", sorted(set(DAMAGE) - {"gap in numbers"}))
def test_strict_stops_at_the_first(tree: Path, tmp_path: Path, kind: str):
    harm, _, file = DAMAGE[kind]
    harm(tree)
    with pytest.raises(RacinesError, match=f"strict.*{file}.*{kind}: "):
        build(source(tree), tmp_path / "racines", DataConfig(workers=1, strict=True))
    assert not (tmp_path / "racines").exists()


def test_too_much_damage_is_refused(tree: Path, tmp_path: Path):
    for number in range(5):
        (tree / LOGS / f"PA_{number}.txt").write_text("")
    with pytest.raises(RacinesError, match="5 of 40 frames refused, more than max_refused 0.1"):
        build(source(tree), tmp_path / "racines", DataConfig(workers=1, max_refused=0.1))
    build(source(tree), tmp_path / "racines", DataConfig(workers=1))


def test_every_truncation_is_seen_before_decoding(tree: Path):
    path = tree / IMAGES / "img3.png"
    content = path.read_bytes()
    for length in (0, 4, 8, 20, 33, 40, len(content) // 2, len(content) - 12, len(content) - 1):
        path.write_bytes(content[:length])
        _, (finding,) = planned(tree)
        assert finding.reason.startswith("truncated PNG: it ends after"), length
    flipped = bytearray(content)
    flipped[len(content) // 2] ^= 1
    path.write_bytes(flipped)
    _, (finding,) = planned(tree)
    assert finding.reason.startswith("damaged PNG: the checksum of its b'IDAT' chunk")


def test_a_unit_of_millimetres_is_named_and_can_be_set(tree: Path):
    for path in tree.rglob("PA_*.txt"):
        row = np.array(parse_log(path.read_text()))
        row[[10, 14, 18]] *= 1000
        path.write_text(log_text(row[0], row[1:7], row[7:23].reshape(4, 4), row[23:29]))
    made = source(tree)
    with pytest.raises(RacinesError, match="millimetres: the whole set.*release.unit to mm"):
        made.plan()
    assert {finding.frames for finding in made.report} == {FRAMES}
    made = source(tree, unit="mm")
    position = made.produce(made.plan()[0]).parameters[:, 6:9]
    assert made.report == [] and (np.abs(position) < 0.6).all()


def test_one_folder_of_millimetres_is_one_finding(tree: Path):
    for number in range(FRAMES):
        millimetres_at(tree, number)
    frames, (finding,) = planned(tree)
    assert frames == TOTAL - FRAMES and finding.frames == FRAMES and finding.file == IMAGES
    assert "all 8 frames" in finding.reason and "likely in mm" in finding.reason
    with pytest.raises(RacinesError, match="metres: the whole set is likely in m"):
        source(write_release(tree.parent / "other"), unit="mm").plan()


def millimetres_at(root: Path, number: int) -> None:
    pose = pose_of(root, number)
    pose[:3, 3] *= 1000
    change(root, number, pose=pose)


def test_out_of_reach_is_no_unit(tree: Path):
    pose = pose_of(tree, 2)
    pose[:3, 3] = [0, 0, 3]
    change(tree, 2, pose=pose)
    _, (finding,) = planned(tree)
    assert finding.reason.startswith("out of reach: the probe is 3 m")
    assert planned(tree, reach=4.0)[1] == []


def test_a_pose_whose_last_row_is_not_that_of_a_pose(tree: Path):
    pose = pose_of(tree, 2)
    pose[3, 0] = 1
    change(tree, 2, pose=pose)
    _, (finding,) = planned(tree)
    assert finding.reason.startswith("not a rigid pose: its last row is [1.")


def test_the_clock(tree: Path):
    change(tree, 3, time=5000.0)
    frames, (finding,) = planned(tree)
    assert frames == TOTAL - 1 and finding.file == f"{LOGS}/PA_3.txt"
    assert finding.reason.startswith("clock: 5000.000000 s does not go on")
    change(tree, 3, time=1000.5 + 2 / 30)
    assert planned(tree)[0] == TOTAL - 1
    frames, (finding,) = planned(tree, allow_repeats=True)
    assert frames == TOTAL and not finding.refused and finding.reason.startswith("clock: 1 frames")


def test_absent_forces_are_nan_only_where_allowed(tree: Path):
    change(tree, 3, wrench=np.full(6, np.nan))
    _, (finding,) = planned(tree)
    assert finding.reason == "NaN: 6 of 6 numbers are not finite"
    made = source(tree, allow_absent=True)
    assert np.isnan(made.produce(made.plan()[0]).parameters[3, :6]).all() and made.report == []


def test_duplicates(tree: Path):
    shutil.copy(tree / IMAGES / "img3.png", tree / IMAGES / "img003.png")
    frames, (finding,) = planned(tree)
    assert frames == TOTAL and finding.file.endswith("img003.png")
    assert finding.reason.endswith(
        "img3.png and img003.png all have number 3; they are equal, one is used"
    )
    shutil.copy(tree / LOGS / "PA_4.txt", tree / LOGS / "PA_03.txt")
    frames, report = planned(tree)
    assert frames == TOTAL - 1
    assert [Path(f.file).name for f in report] == ["img003.png", "PA_3.txt", "PA_03.txt"]


def test_mixed_sizes(tree: Path):
    Image.new("L", (64, 64)).save(tree / IMAGES / "img3.png")
    frames, (finding,) = planned(tree)
    assert frames == TOTAL - 1 and finding.reason == "mixed sizes: 64×64, 7 others are 128×128"
    write_frames(tree / "Folder 3/PL/images", tree / "Folder 3/PL/logs", 7, size=(96, 96))
    frames, report = planned(tree)
    assert frames == TOTAL - 1 + FRAMES and not report[1].refused
    assert report[1].reason.startswith("mixed sizes: 96×96 here, 128×128 in Folder 1/A4C")


def test_litter_is_ignored_and_other_files_are_flagged(tree: Path):
    for name in (".DS_Store", "Thumbs.db", "desktop.ini", "._img1.png"):
        for folder in (tree, tree / "Folder 1", tree / "Folder 1/SC", tree / IMAGES, tree / LOGS):
            (folder / name).touch()
    (tree / "Folder 1.dvc").touch()
    assert planned(tree) == (TOTAL, [])
    (tree / IMAGES / "notes.txt").touch()
    (tree / "Folder 2/A5C").mkdir()
    frames, report = planned(tree)
    assert frames == TOTAL and not any(finding.refused for finding in report)
    assert [(f.file, f.reason.split(", left")[0]) for f in report] == [
        ("Folder 2", "unknown file: A5C: not of the published layout"),
        (IMAGES, "unknown file: notes.txt: not of the published layout"),
    ]


def test_one_sided_folders(tree: Path):
    shutil.rmtree(tree / "Folder 1/SC/logs_1")
    shutil.rmtree(tree / "Folder 1/SC/images_2")
    frames, report = planned(tree)
    assert frames == TOTAL - 2 * FRAMES
    assert [(f.file, f.frames, f.reason.partition(":")[0]) for f in report] == [
        ("Folder 1/SC/images_1", FRAMES, "missing log"),
        ("Folder 1/SC/logs_2", FRAMES, "missing image"),
    ]


def test_many_gaps_are_one_finding(tmp_path: Path):
    write_frames(tmp_path / IMAGES, tmp_path / LOGS, 1, range(0, 60, 2))
    frames, (finding,) = planned(tmp_path)
    assert frames == 30 and finding.reason.startswith("gap in numbers: 29 numbers are skipped")


def test_what_is_no_release_is_refused(tree: Path, tmp_path: Path):
    with pytest.raises(RacinesError, match=f"holds no `Folder 1`.*; give {tree}"):
        source(tree.parent).plan()
    with pytest.raises(RacinesError, match="name one folder: --input FOLDER"):
        ReleaseSource.from_config({}, [])
    with pytest.raises(RacinesError, match="no such folder"):
        source(tmp_path / "nothing")
    with pytest.raises(RacinesError, match="data.release.unit 'km'"):
        source(tree, unit="km")
    with pytest.raises(RacinesError, match="data.release.untis: unknown key"):
        source(tree, untis="mm")
    shutil.copytree(tree / "Folder 1", tree / "folder_1")
    with pytest.raises(RacinesError, match="both stand for folder-1-a4c: rename one"):
        source(tree).plan()


def test_recipe_knows_every_byte_and_no_path(tree: Path, tmp_path: Path):
    moved = shutil.copytree(tree, tmp_path / "moved")
    assert source(tree).recipe() == source(moved).recipe()
    change(moved, 3, time=1000.5001)
    assert source(tree).recipe()["inputs"] != source(moved).recipe()["inputs"]


def test_a_file_that_vanishes_is_named(tree: Path, tmp_path: Path):
    made = source(tree)
    units = made.plan()
    (tree / IMAGES / "img3.png").unlink()
    with pytest.raises(RacinesError, match="img3.png: cannot be read.*import again"):
        made.produce(units[0])


def test_other_organs_have_folders_of_their_own(tmp_path: Path):
    write_frames(tmp_path / "Folder 1/LONG/images", tmp_path / "Folder 1/LONG/logs", 1)
    made = source(tmp_path, views=["LONG", "CROSS"], label_views=True)
    root = tmp_path / "racines"
    manifest = build(made, root, DataConfig(workers=1))
    assert manifest["labels"] == ["LONG", "CROSS", "Random"]
    assert datasets.load_dataset(str(root), split="train").features["view"].names[0] == "LONG"


@pytest.mark.slow
def test_a_killed_import_goes_on(tmp_path: Path):
    tree = tmp_path / "release"
    for index in range(24):
        folder = tree / f"Folder {index // 8 + 1}/SC"
        write_frames(
            folder / f"images_{index}", folder / f"logs_{index}", index, range(60), (400, 300)
        )
    code = "from racines_leaderboard.cli import main; main()"
    words = [sys.executable, "-c", code, "data", "import", str(tree), "--out", "racines"]
    words += ["--workers", "1", "--json", "--profile", "smoke"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    options = {"cwd": tmp_path, "env": environment, "stdout": subprocess.PIPE}
    process = subprocess.Popen(words, **options)
    for _ in range(6000):
        if len(staged(tmp_path)) >= 3:
            break
        assert process.poll() is None, "the import ended before it was killed"
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert not (tmp_path / "racines").exists()
    kept = {path: path.stat().st_mtime_ns for path in staged(tmp_path)}
    assert 3 <= len(kept) < 24

    made: list[str] = []

    class Watched(ReleaseSource):
        def produce(self, unit):
            made.append(unit.id)
            return super().produce(unit)

    Watched.__module__ = ReleaseSource.__module__  # the staging folder is told apart by code
    config = DataConfig(workers=1, seed=0)
    manifest = build(Watched.from_config({}, [tree]), tmp_path / "racines", config)
    assert len(made) == 24 - len(kept) and staged(tmp_path) == []
    undisturbed = build(source(tree), tmp_path / "again", config)
    assert manifest["digest"] == undisturbed["digest"]


def staged(folder: Path) -> list[Path]:
    return sorted(folder.glob(".racines.staging-*/**/units/*.arrow"))
