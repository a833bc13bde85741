"""The gate at import: each mistake in files of the published layout, of a tracker, of CACTUS."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from typer.testing import CliRunner

from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.geometry import euler_to_matrix
from racines_data.sources.release import ReleaseSource
from racines_data.sources.tracked import TrackedSource
from racines_data.validate.run import validate
from racines_leaderboard.cli.command import app
from tests.data.release_tree import log_text
from tests.data.sources import test_cactus, test_tracked
from tests.data.sources.gate_source import MISTAKES, POSITION, Columns, mirror, sound

ONE = DataConfig(workers=1, shards=1)
PLACES = ("Folder 1/A4C", "Folder 1/SC", "Folder 2/PL")


def write_release(root: Path, mistake: str = "", matrix=None, only: str = "") -> Path:
    """Write sound sweeps in the published layout, with a mistake in the columns or matrices."""
    for number, place in enumerate(PLACES):
        columns = sound(number)
        if mistake and only in ("", place):
            columns = MISTAKES[mistake][0](columns)
        _write(root / place, columns, matrix if only in ("", place) else None)
    return root


def _write(folder: Path, columns: Columns, matrix) -> None:
    images, logs = folder / "images", folder / "logs"
    images.mkdir(parents=True)
    logs.mkdir()
    rows = columns["parameters"].astype(float)
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, :3] = euler_to_matrix(torch.from_numpy(rows[:, 9:])).numpy()
    poses[:, :3, 3] = rows[:, POSITION]
    if matrix is not None:
        poses = matrix(poses)
    for frame, (row, pose) in enumerate(zip(rows, poses, strict=True)):
        Image.fromarray(columns["images"][frame]).save(images / f"img{frame}.png")
        text = log_text(columns["timestamps"][frame], row[:6], pose, columns["controls"][frame])
        (logs / f"PA_{frame}.txt").write_text(text)


def rotated(change):
    def matrix(poses: np.ndarray) -> np.ndarray:
        poses = poses.copy()
        poses[:, :3, :3] = change(poses[:, :3, :3])
        return poses

    return matrix


def refused(root: Path, **settings) -> str:
    with pytest.raises(RacinesError) as caught:
        build(ReleaseSource.from_config(settings, [root]), root.parent / "out", ONE)
    assert not (root.parent / "out").exists() and "\n" not in f"{caught.value}"
    return f"{caught.value}"


def test_sound_sweeps_are_imported_whole(tmp_path: Path):
    source = ReleaseSource.from_config({}, [write_release(tmp_path / "tree")])
    manifest = build(source, tmp_path / "out", ONE)
    assert manifest["counts"]["frames"] == 120 and source.report == []
    assert validate(tmp_path / "out").ok


MATRICES = {
    "mirrored": (lambda r: r @ mirror(0).numpy(), "reflected rotation: its determinant is -1"),
    "mirrored base": (lambda r: mirror(2).numpy() @ r, "its determinant is -1: left-handed"),
    "not unit": (lambda r: 2.0 * r, "it is not unit: a rotation times 2; divide by that"),
    "in degrees": (np.degrees, "it is not unit: a rotation times 57.3"),
    "transposed": (lambda r: r.transpose(0, 2, 1), "transposed rotation: rotation: turns with"),
    "beam turned round": (
        lambda r: r @ np.diag([1.0, -1.0, -1.0]),
        "looks up: rotation: the beam .* points up",
    ),
}


@pytest.mark.parametrize("name", MATRICES)
def test_rotations_of_logs(tmp_path: Path, name: str):
    change, said = MATRICES[name]
    tree = write_release(tmp_path / "tree", matrix=rotated(change))
    message = refused(tree)
    import re

    assert re.search(said, message), message
    assert "Folder 1/A4C/logs/PA_0.txt" in message or "source release, trajectory folder" in message


def test_a_matrix_written_by_columns(tmp_path: Path):
    tree = write_release(tmp_path / "tree", matrix=lambda poses: poses.transpose(0, 2, 1))
    assert "not a rigid pose: its last row is" in refused(tree)
    assert "likely transposed: give the position as last column" in refused(tree)


LOGS = {
    "millimetres": "millimetres: the whole set is likely in mm.*set data.release.unit to mm",
    "centimetres": "centimetres: the whole set is likely in cm.*multiply the positions.*by 0.01",
    "milliseconds": "trajectory folder-1-a4c: clock: timestamp: .*likely milliseconds",
    "backwards": "clock: .*does not go on",
    "repeated": "clock: .*does not go on",
    "left-handed": "reflected rotation: position: y moves against",
    "grams": "unit of force: force: .*likely grams-force",
    "action for reaction": "sign of force: force_z: .*change its sign",
    "0-1": "range of gray: image: .*likely 0-1",
    "constant": "constant image: image: 40 of 40",
    "frozen": "frozen: image: 39 of 40",
    "upside down": "turned image: image: .*at the bottom",
    "stale pose": "frozen: pose: ",
}


@pytest.mark.parametrize("mistake", LOGS)
def test_each_mistake_in_the_published_layout(tmp_path: Path, mistake: str):
    import re

    message = refused(write_release(tmp_path / "tree", mistake))
    assert re.search(LOGS[mistake], message), message


@pytest.mark.parametrize("mistake", ["millimetres", "centimetres", "mixed frames"])
def test_units_mixed_in_one_folder(tmp_path: Path, mistake: str):
    """Frames in another unit are refused one by one, and too many stop the import."""
    tree = write_release(tmp_path / "tree", mistake, only=PLACES[2])
    lost = 20 if mistake == "mixed frames" else 40
    if lost == 40:
        assert f"{lost} of 120 frames refused, more than max_refused 0.2" in refused(tree)
        assert f"likely in {'mm' if mistake == 'millimetres' else 'cm'}" in refused(tree)
    source = ReleaseSource.from_config({}, [tree])
    manifest = build(source, tmp_path / "out", DataConfig(workers=1, shards=1, max_refused=0.5))
    assert manifest["counts"]["frames"] == 120 - lost
    assert {f.reason.partition(":")[0] for f in source.report} <= {"millimetres", "centimetres"}


def test_one_folder_in_millimetres_of_a_set_read_in_millimetres(tmp_path: Path):
    tree = write_release(tmp_path / "tree", "millimetres", only=PLACES[2])
    message = refused(tree, unit="mm")
    assert "metres: all 40 frames" in message and "the position is likely in m" in message


def test_the_command_refuses_and_its_json_says_why(tmp_path: Path):
    tree = write_release(tmp_path / "tree", "grams")
    words = ["data", "import", str(tree), "--out", str(tmp_path / "out"), "--workers", "1"]
    done = CliRunner().invoke(app, [*words, "--json"])
    assert done.exit_code == 1 and not (tmp_path / "out").exists()
    told = json.loads(done.stdout)["error"]
    assert "source release, trajectory folder-1-a4c: unit of force" in told


def test_the_command_can_allow_what_the_gate_infers(tmp_path: Path):
    tree = write_release(tmp_path / "tree", "action for reaction")
    words = ["data", "import", str(tree), "--out", str(tmp_path / "out"), "--workers", "1"]
    assert CliRunner().invoke(app, words).exit_code == 1
    assert CliRunner().invoke(app, [*words, "--allow", "force-sign"]).exit_code == 0
    assert validate(tmp_path / "out").ok


# --- tracked sweeps -------------------------------------------------------------------------------


def tracked(folder: Path, poses=None, changes=None) -> str:
    path = test_tracked.write_sequence(folder / "a.igs.mha", changes, poses)
    with pytest.raises(RacinesError) as caught:
        build(TrackedSource.from_config({}, [path]), folder / "out", ONE)
    return f"{caught.value}"


def changed(change) -> dict[int, np.ndarray]:
    return {index: change(test_tracked.pose(index)) for index in range(test_tracked.COUNT)}


def in_unit(factor: float):
    return lambda pose: np.block([[pose[:3, :3], pose[:3, 3:] * factor], [pose[3:]]])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda pose: pose @ np.diag([-1.0, 1, 1, 1]), "is left-handed"),
        (lambda pose: pose @ np.diag([2.0, 2, 2, 1]), "it is not unit: a rotation times 2"),
        (lambda pose: pose.T, "likely transposed: give the position as last column"),
        (in_unit(1e-3), "they are likely in m: set unit to m"),
        (in_unit(10.0), "give them in mm or m"),
    ],
)
def test_poses_of_a_tracker(tmp_path: Path, change, said: str):
    assert said in tracked(tmp_path, changed(change))


def test_a_tracker_in_centimetres_read_in_metres(tmp_path: Path):
    path = test_tracked.write_sequence(tmp_path / "a.igs.mha", None, changed(in_unit(0.1)))
    with pytest.raises(RacinesError, match="they are likely in cm: convert them to mm"):
        build(TrackedSource.from_config({"unit": "m"}, [path]), tmp_path / "out", ONE)


def test_tracked_sweeps_of_different_units(tmp_path: Path):
    """Centimetres read as millimetres are within a tracker's reach; beside others they are not."""
    one = test_tracked.write_sequence(tmp_path / "a.igs.mha")
    two = test_tracked.write_sequence(tmp_path / "b.igs.mha")
    odd = test_tracked.write_sequence(tmp_path / "c.igs.mha", None, changed(in_unit(0.01)))
    build(TrackedSource.from_config({}, [one, two]), tmp_path / "out", ONE)
    with pytest.raises(RacinesError, match="source tracked, trajectory c-0.: position: mixed unit"):
        build(TrackedSource.from_config({}, [one, two, odd]), tmp_path / "all", ONE)


def clock(times) -> dict[str, str]:
    return {f"Seq_Frame{i:04d}_Timestamp": f"{time:.6f}" for i, time in enumerate(times)}


@pytest.mark.parametrize(
    ("times", "said"),
    [
        (100 - 0.1 * np.arange(10), "9 of 10 frames refused"),
        (np.full(10, 100.0), "9 of 10 frames refused"),
        (1e6 + 40 * np.arange(10), "clock: timestamp: 40 s from frame to frame: likely millisec"),
    ],
)
def test_clocks_of_a_tracker(tmp_path: Path, times: np.ndarray, said: str):
    assert said in tracked(tmp_path, changes=clock(times))


@pytest.mark.parametrize(
    ("images", "said"),
    [
        (np.full((10, 40, 60), 90, np.uint8), "constant image: image"),
        (np.random.default_rng(0).integers(0, 2, (10, 40, 60), np.uint8), "range of gray: image"),
    ],
)
def test_images_of_a_tracker(tmp_path: Path, monkeypatch, images: np.ndarray, said: str):
    import re

    monkeypatch.setattr(test_tracked, "images", lambda: images)
    message = tracked(tmp_path)
    assert re.search(f"source tracked, trajectory a-00: ({said})", message), message


def test_frozen_images_of_a_tracker(tmp_path: Path, monkeypatch):
    still = np.repeat(test_tracked.images()[:1], 10, 0)
    monkeypatch.setattr(test_tracked, "images", lambda: still)
    path = test_tracked.write_sequence(tmp_path / "a.igs.mha")
    with pytest.raises(RacinesError, match="trajectory a-00: frozen: image: 9 of 10 frames repeat"):
        build(TrackedSource.from_config({"segments": 1}, [path]), tmp_path / "out", ONE)


# --- CACTUS ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda image, first: np.full_like(image, 90), "constant image: image"),
        (lambda image, first: image // 255, "range of gray: image: .*likely 0-1"),
        (lambda image, first: first, "frozen: image: 11 of 12 frames"),
        (lambda image, first: 255 - image, "range of gray: image: .*likely inverted"),
    ],
)
def test_images_of_cactus(tmp_path: Path, monkeypatch, change, said: str):
    screen, first = test_cactus.screen, test_cactus.screen(np.random.default_rng(0))
    monkeypatch.setattr(test_cactus, "screen", lambda rng: change(screen(rng), first))
    root = test_cactus.write_cactus(tmp_path / "cactus")
    with pytest.raises(RacinesError, match=f"source cactus, trajectory a4c-000: {said}"):
        build(test_cactus.source(root, crop="none"), tmp_path / "out", ONE)
