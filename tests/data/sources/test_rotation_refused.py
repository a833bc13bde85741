"""What is wrong with a recording of turns is refused, with file and key, and nothing is made."""

import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.sources.rotation.source import RotationSource
from tests.data.sources.rotation_folder import (
    SIDE,
    content_of,
    pose,
    write_content,
    write_rotation,
)

ONE = DataConfig(workers=1, shards=1)
FILE = "transforms_train.json"


def refused(folder: Path, said: str, **settings) -> str:
    """Check that an import is refused in one line, with nothing written; return the line."""
    out = folder.parent / "out"
    with pytest.raises(RacinesError, match=said) as caught:
        build(RotationSource.from_config(settings, [folder]), out, ONE)
    assert "\n" not in f"{caught.value}" and not out.exists()
    assert not list(folder.parent.glob(".out*"))
    return f"{caught.value}"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_rotation(tmp_path / "heart", turns=12)


def edited(folder: Path, edit: Callable[[dict], object]) -> Path:
    content = content_of(folder)
    edit(content)
    write_content(folder, content)
    return folder


def matrix(k: int, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[dict], object]:
    """Return an edit of frame k's (3, 4) matrix."""

    def edit(content: dict) -> None:
        frame = content["frames"][k]
        frame["transform_matrix"] = change(np.array(frame["transform_matrix"])).tolist()

    return edit


def mirrored(rows: np.ndarray) -> np.ndarray:
    return rows * np.array([-1.0, 1.0, 1.0, 1.0])


def nan(rows: np.ndarray) -> np.ndarray:
    rows[1, 2] = np.nan
    return rows


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (matrix(7, mirrored), r"frames\[7\].transform_matrix: mirrored: reflected rotation: .* -1"),
        (matrix(4, lambda rows: 1.1 * rows), r"frames\[4\].transform_matrix: non-orthonormal"),
        (matrix(5, nan), r"frames\[5\].transform_matrix: NaN: has numbers that are not finite"),
        (matrix(2, lambda rows: rows[:2]), r"frames\[2\].transform_matrix: not a matrix of 3 × 4"),
        (matrix(2, np.ravel), r"frames\[2\].transform_matrix: not a matrix of 3 × 4"),
        (matrix(3, lambda rows: rows + 1e-5), r"frames\[3\].*: 1 frames have this pose, where 3"),
        (
            lambda c: c["frames"][6].pop("transform_matrix"),
            r"frames\[6\].transform_matrix: missing",
        ),
        (lambda c: c["frames"][6].update(file_path=7), r"frames\[6\].file_path: 7: give a file's"),
        (lambda c: c["frames"].__setitem__(1, [1]), r"frames\[1\]: .*an object with keys"),
        (lambda c: c.update(frames={}), "key `frames`: give a list"),
        (lambda c: c.update(frames=[]), "key `frames`: give a list"),
        (lambda c: c.update(w=64), f"w: 64, where images/0000.png has {SIDE} pixels"),
        (lambda c: c.update(h="tall"), "w, h: 'tall' is no number"),
        (lambda c: c.update(w=float("nan")), "w, h: nan is not finite"),
        (lambda c: c.update(w=10**400), "w, h: 1000.* is not finite"),
        (lambda c: c["frames"].pop(), "frames: 35 of them, and 36 images in images"),
        (lambda c: c["frames"][3].update(time=0.5), r"frames\[0\].time: missing, where others"),
        (lambda c: [f.update(time=0.5) for f in c["frames"]], r"frames\[1\].time: two frames of"),
        (lambda c: [f.update(time=1.0) for f in c["frames"]], r"frames\[0\].time: 1 is no phase"),
        (lambda c: [f.update(time=True) for f in c["frames"]], r"frames\[0\].time: 'True' is no"),
    ],
)
def test_the_file_of_poses(folder: Path, edit: Callable, said: str):
    assert FILE in refused(edited(folder, edit), said)


def test_one_frame_of_a_text(folder: Path):
    def edit(content: dict) -> None:
        content["frames"][9]["transform_matrix"][0][0] = "one"

    refused(edited(folder, edit), r"frames\[9\].transform_matrix: 'one' is no number")


def test_a_last_row_that_is_none(folder: Path):
    def edit(content: dict) -> None:
        for frame in content["frames"]:
            frame["transform_matrix"].append([0, 0, 0, 2])

    refused(edited(folder, edit), r"frames\[0\].transform_matrix: not a rigid pose: its last row")


def test_matrices_of_the_world_in_the_image_are_told(folder: Path):
    def edit(content: dict) -> None:
        for frame in content["frames"]:
            whole = np.vstack([frame["transform_matrix"], [0, 0, 0, 1]])
            frame["transform_matrix"] = np.linalg.inv(whole)[:3].tolist()

    refused(edited(folder, edit), "no turns about an apex: .*inverted, the matrices would fit")


def test_poses_that_wander_are_no_rotation(folder: Path):
    def edit(content: dict) -> None:
        for number, frame in enumerate(content["frames"]):
            rows = pose(10.0 * (number // 3))
            rows[:3, 3] += 5.0 * (number // 3)
            frame["transform_matrix"] = rows[:3].tolist()

    refused(edited(folder, edit), "no turns about an apex: the image's top middle wanders by")


def test_no_file_of_poses_and_two(folder: Path):
    other = folder / "transforms_test.json"
    other.write_bytes((folder / FILE).read_bytes())
    said = r"2 files of poses, transforms_test.json, transforms_train.json: name the one"
    refused(folder, said)
    assert RotationSource.from_config({"transforms": FILE}, [folder]).plan()
    refused(folder, "transforms: other.json: no such file", transforms="other.json")
    other.unlink()
    (folder / FILE).unlink()
    refused(folder, r"no file of poses \(transforms\*.json\)")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "not JSON"),
        (b'{"frames": [', "not JSON"),
        (b"[1]", "key `frames`"),
        (b"\xff\xfe", "not"),
    ],
)
def test_files_that_are_no_json(folder: Path, content: bytes, said: str):
    (folder / FILE).write_bytes(content)
    refused(folder, f"{FILE}: {said}")


def test_a_byte_order_mark_is_read_over(folder: Path):
    (folder / FILE).write_bytes(b"\xef\xbb\xbf" + (folder / FILE).read_bytes())
    assert len(RotationSource.from_config({}, [folder]).plan()) == 12


def test_too_few_turns(tmp_path: Path):
    refused(write_rotation(tmp_path / "heart", turns=5), "5 turns: splits by turn need 6 or more")


# --- images ---------------------------------------------------------------------------------------


def test_missing_images(folder: Path):
    (folder / "images" / "0007.png").unlink()
    refused(folder, f"{FILE}: frames: 36 of them, and 35 images in images: every frame needs")


def test_one_missing_where_names_are_right(folder: Path):
    def edit(content: dict) -> None:
        for k, frame in enumerate(content["frames"]):
            frame["file_path"] = f"./images/{k:04d}"  # as radiance fields name them: no ending

    edited(folder, edit)
    assert len(RotationSource.from_config({}, [folder]).plan()) == 12
    (folder / "images" / "0007.png").unlink()
    refused(folder, r"frames\[7\].file_path: ./images/0007: no such image, where 35 of 36")


def test_two_frames_of_one_image(folder: Path):
    def edit(content: dict) -> None:
        for k, frame in enumerate(content["frames"]):
            frame["file_path"] = f"images/{min(k, 34):04d}.png"

    refused(edited(folder, edit), r"frames\[35\].file_path: .*names the image of another frame")


def test_mixed_sizes(folder: Path):
    Image.fromarray(np.zeros((SIDE, SIDE + 2), np.uint8)).save(folder / "images" / "0011.png")
    refused(folder, f"0011.png: mixed sizes: {SIDE + 2}×{SIDE} pixels, others {SIDE}×{SIDE}")


def test_damaged_images(folder: Path):
    path = folder / "images" / "0020.png"
    path.write_bytes(path.read_bytes()[:200])
    refused(folder, "0020.png: truncated PNG")


def test_images_upside_down(folder: Path):
    for path in (folder / "images").iterdir():
        Image.open(path).transpose(Image.Transpose.FLIP_TOP_BOTTOM).save(path)
    refused(folder, "turned image: the sector's tip is at the bottom")


def test_no_images_and_two_folders(folder: Path):
    (folder / "masks").mkdir()
    for path in (folder / "images").iterdir():
        os.link(path, folder / "masks" / path.name)
    refused(folder, "images lie in 2 folders, images, masks: name theirs: --set images=images")
    assert RotationSource.from_config({"images": "images"}, [folder]).plan()
    refused(folder, "images: ../elsewhere: no such folder", images="../elsewhere")
    refused(folder, "images: nowhere: no such folder", images="nowhere")
    for path in [*(folder / "images").iterdir(), *(folder / "masks").iterdir()]:
        path.unlink()
    refused(folder, re.escape("holds no image (.png, .jpg, .jpeg)"))


def test_a_link_out_of_the_folder(folder: Path, tmp_path: Path):
    path = folder / "images" / "0003.png"
    path.rename(tmp_path / "elsewhere.png")
    path.symlink_to(tmp_path / "elsewhere.png")
    refused(folder, "images: images/0003.png: a link out of the folder")


def test_a_fifo(folder: Path):
    path = folder / "images" / "0003.png"
    path.unlink()
    os.mkfifo(path)
    refused(folder, "images: images/0003.png: a FIFO, a socket or a device")


def test_a_fifo_for_poses(folder: Path):
    (folder / FILE).unlink()
    os.mkfifo(folder / FILE)
    refused(folder, f"transforms: {FILE}: a FIFO, a socket or a device")


def test_frozen_frames(folder: Path):
    first = (folder / "images" / "0000.png").read_bytes()
    for path in (folder / "images").iterdir():
        path.write_bytes(first)
    refused(folder, r"0000.png: frozen: 35 of 36 images are the bytes of another")


def test_names_that_lead_out_of_the_folder_are_not_followed(folder: Path):
    def edit(content: dict) -> None:
        for k, frame in enumerate(content["frames"]):
            frame["file_path"] = f"../../{folder.name}/images/{k:04d}.png"

    made = RotationSource.from_config({}, [edited(folder, edit)])
    assert len(made.plan()) == 12 and any(
        "names no file here" in each.reason for each in made.report
    )
