import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from racines_data import RacinesError
from racines_data.build.dataset import DataConfig, build
from racines_data.sources.release.layout import parse_log
from racines_data.validate.run import validate
from tests.data.pipes import fifo
from tests.data.release_helpers import IMAGES, LOGS, TOTAL, change, planned, pose_of, source
from tests.data.release_tree import (
    FRAMES,
    log_text,
    write_frames,
    write_release,
)


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    return write_release(tmp_path / "release")


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


@pytest.mark.parametrize(
    ("file", "kind"),
    [(f"{IMAGES}/img3.png", "unreadable image"), (f"{LOGS}/PA_3.txt", "unreadable log")],
)
def test_no_fifo_is_waited_for_and_no_link_out_followed(tree: Path, file: str, kind: str):
    place, aside = tree / file, tree.parent / "aside"
    shutil.copy(place, aside)
    place.unlink()
    place.symlink_to(aside)
    frames, (finding,) = planned(tree)
    assert frames == TOTAL - 1 and finding.file == file
    told = f"{kind}: a link out of the folder, to {aside}: put the file itself there"
    assert finding.reason == told
    with fifo(place):
        frames, (finding,) = planned(tree)
    assert frames == TOTAL - 1 and finding.file == file
    assert finding.reason.startswith(f"{kind}: a FIFO, a socket or a device, where a file is")


def test_a_linked_folder_is_not_followed_and_no_double_opened(tree: Path):
    (tree / IMAGES).rename(tree.parent / "aside")
    (tree / IMAGES).symlink_to(tree.parent / "aside")
    frames, report = planned(tree)
    assert frames == TOTAL - FRAMES and len(report) == FRAMES
    assert all("a link out of the folder" in finding.reason for finding in report)
    with fifo(tree / LOGS / "PA_03.txt"):
        _, report = planned(tree)
    assert "they differ, none is used" in report[0].reason


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
