import os
import pickle
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import datasets
import numpy as np
import pytest
import torch
from PIL import Image

from racines_data import RacinesError, open_store
from racines_data.build.dataset import DataConfig, build
from racines_data.geometry import geodesic, parameters_to_pose
from racines_data.sources.base import source_class
from racines_data.sources.images import square
from racines_data.sources.release.source import ReleaseSource
from racines_data.validate.run import validate
from tests.conftest import ROOT
from tests.data.release_helpers import IMAGES, LOGS, TOTAL, change, planned, source
from tests.data.release_tree import (
    FRAMES,
    read_elsewhere,
    write_frames,
    write_release,
)
from tests.waiting import until


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    return write_release(tmp_path / "release")


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


def test_a_byte_order_mark_and_signs_that_look_like_digits_are_read_over(tree: Path):
    plain = source(tree)
    expected = [plain.produce(unit).parameters for unit in plain.plan()]
    for log in tree.rglob("*.txt"):
        log.write_bytes(b"\xef\xbb\xbf" + log.read_bytes())
    (tree / "note 5²").write_text("a note")
    (tree / "²").mkdir()
    made = source(tree)
    found = [made.produce(unit).parameters for unit in made.plan()]
    assert len(found) == len(expected)
    assert all(map(np.array_equal, found, expected))


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


def test_too_much_damage_is_refused(tree: Path, tmp_path: Path):
    for number in range(5):
        (tree / LOGS / f"PA_{number}.txt").write_text("")
    with pytest.raises(RacinesError, match="5 of 40 frames refused, more than max_refused 0.1"):
        build(source(tree), tmp_path / "racines", DataConfig(workers=1, max_refused=0.1))
    build(source(tree), tmp_path / "racines", DataConfig(workers=1))


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


HALTS = """
from racines_data.sources.release import ReleaseSource
from racines_leaderboard.cli import main
from tests.waiting import halt

real, made = ReleaseSource.produce, []
def produce(self, unit):
    made.append(unit)
    if len(made) > 8:
        halt()
    return real(self, unit)
ReleaseSource.produce = produce
main()
"""
"""The command, in which the ninth of twelve recordings is never finished."""


@pytest.mark.slow
@pytest.mark.thorough
def test_a_killed_import_goes_on(tmp_path: Path):
    tree = tmp_path / "release"
    for index in range(12):
        folder = tree / f"Folder {index // 4 + 1}/SC"
        write_frames(
            folder / f"images_{index}", folder / f"logs_{index}", index, range(40), (400, 300)
        )
    code = "from racines_leaderboard.cli.command import main; main()"
    words = [sys.executable, "-c", code, "data", "import", str(tree), "--out", "racines"]
    words = [sys.executable, "-c", HALTS, "data", "import", str(tree), "--out", "racines"]
    words += ["--workers", "1", "--json", "--profile", "smoke"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    options = {"cwd": tmp_path, "env": environment, "stdout": subprocess.PIPE}
    process = subprocess.Popen(words, **options)
    until(lambda: len(staged(tmp_path)) >= 3, process)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert not (tmp_path / "racines").exists()
    kept = {path: path.stat().st_mtime_ns for path in staged(tmp_path)}
    assert 3 <= len(kept) < 12

    made: list[str] = []

    class Watched(ReleaseSource):
        def produce(self, unit):
            made.append(unit.id)
            return super().produce(unit)

    Watched.__module__ = ReleaseSource.__module__  # the staging folder is told apart by code
    config = DataConfig(workers=1, seed=0)
    manifest = build(Watched.from_config({}, [tree]), tmp_path / "racines", config)
    assert len(made) == 12 - len(kept) and staged(tmp_path) == []
    undisturbed = build(source(tree), tmp_path / "again", config)
    assert manifest["digest"] == undisturbed["digest"]


def staged(folder: Path) -> list[Path]:
    return sorted(folder.glob(".racines.staging-*/**/units/*.arrow"))
