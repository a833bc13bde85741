"""A label map that becomes a phantom: its affine is honoured, and what is unusable is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.own import from_labels
from racines_data.phantom.abdomen import BILE, CORTEX, GALLBLADDER_WALL, PYRAMID, SINUS, abdomen
from racines_data.phantom.abdomen import LIVER as LIVER_TISSUE
from racines_data.phantom.saved import Saved, read_saved
from tests.data.pipes import fifo

nibabel = pytest.importorskip("nibabel", reason="needs racines[anatomy]")
organs = pytest.importorskip("tests.data.own.organs")

SHEET: dict[str, Any] = {
    "name": "gallbladder",
    "source": "the built-in abdomen",
    "parts": {
        "liver": {"label": 1, "tissue": "liver"},
        "kidney": {"label": 2, "tissue": "renal cortex"},
        "bile": {"label": 7, "tissue": "bile"},
    },
    "landmarks": {
        "body": {"part": "bile", "radius": 12},
        "neck": {"at": [-20.0, 38.0, -77.0], "radius": 12},
        "liver in front": {"at": [-2.0, 30.0, -40.0], "radius": 16},
    },
    "views": {
        "GBL": {
            "pose": {
                "focus": [1.0, 34.5, -69.0],
                "beam": [0.0, 0.0, -1.0],
                "right": [1.0, -0.2, 0.0],
            },
            "shows": {"body": 2, "neck": 1, "liver in front": 1},
            "title": "gallbladder, along",
        },
    },
    "place": {"up": [0.0, 0.0, 1.0], "ahead": [1.0, 0.0, 0.0], "depth": 10.0, "x": 490, "y": 16},
}
EDGE = 3.0


def abdomen_map() -> tuple[np.ndarray, np.ndarray]:
    """Return labels of the built-in abdomen on a grid of 3 mm, and their affine."""
    axes = [np.arange(a, b, EDGE) for a, b in ((-72, 72), (-57, 66), (-120, -8))]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    tissue = abdomen().paint(torch.from_numpy(points).float() * 1e-3).numpy()
    labels = np.zeros(len(points), np.int16)
    for label, tissues in (
        (1, (LIVER_TISSUE,)),
        (2, (CORTEX, PYRAMID, SINUS)),
        (7, (BILE, GALLBLADDER_WALL)),
    ):
        labels[np.isin(tissue, tissues)] = label
    affine = np.diag([EDGE, EDGE, EDGE, 1.0])
    affine[:3, 3] = [axis[0] for axis in axes]
    return labels.reshape([len(axis) for axis in axes]), affine


@pytest.fixture(scope="module")
def mapped() -> tuple[np.ndarray, np.ndarray]:
    return abdomen_map()


def save(path: Path, labels: np.ndarray, affine: np.ndarray | None, unit: str = "mm") -> Path:
    image = nibabel.Nifti1Image(labels, affine)
    image.header.set_xyzt_units(unit)
    if affine is None:
        image.header["sform_code"] = image.header["qform_code"] = 0
    nibabel.save(image, path)
    return path


def made(folder: Path, labels: np.ndarray, affine: np.ndarray) -> Saved:
    sheet = organs.write_sheet(folder / "gallbladder.yaml", SHEET)
    from_labels(save(folder / "map.nii.gz", labels, affine), sheet, folder / "out")
    return read_saved(folder / "out")


@pytest.fixture(scope="module")
def phantom(mapped: tuple, tmp_path_factory: pytest.TempPathFactory) -> Saved:
    return made(tmp_path_factory.mktemp("labels"), *mapped)


def _flipped(labels: np.ndarray, affine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn the first axis round; the affine says so."""
    turn = np.diag([-1.0, 1.0, 1.0, 1.0])
    turn[0, 3] = labels.shape[0] - 1
    return labels[::-1], affine @ turn


def _permuted(labels: np.ndarray, affine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Store head to foot first; the affine says so."""
    return labels.transpose(2, 0, 1), affine @ np.eye(4)[:, [2, 0, 1, 3]]


def test_it_lies_where_its_affine_says(phantom: Saved, mapped: tuple):
    points = torch.tensor([[1.0, 34.5, -69.0], [0.0, 0.0, -30.0], [300.0, 0.0, 0.0]]) * 1e-3
    numbers = phantom.number_at(points).tolist()
    assert numbers == [3, 1, 0]
    assert [phantom.told["tissues"][i]["name"] for i in phantom.paint(points).tolist()] == [
        "bile",
        "liver",
        "gel",
    ]
    labels, _ = mapped
    assert phantom.told["parts"][2]["ml"] == pytest.approx((labels == 7).sum() * EDGE**3 / 1e3)
    assert phantom.told["shown"]["GBL"] > 8.0


@pytest.mark.parametrize("stored", [_flipped, _permuted])
def test_however_its_axes_are_stored_it_is_the_same_phantom(
    stored: Any, phantom: Saved, mapped: tuple, tmp_path: Path
):
    other = made(tmp_path, *stored(*mapped))
    assert torch.equal(other.tensors["labels"], phantom.tensors["labels"])
    for name in ("grid", "views", "structures", "place", "parts"):
        assert other.told[name] == phantom.told[name], name
    assert other.told["digest"] == phantom.told["digest"]


def test_an_oblique_map_is_turned(phantom: Saved, mapped: tuple, tmp_path: Path):
    cos, sin = np.cos(0.3), np.sin(0.3)
    turn = np.array([[cos, -sin, 0, 0], [sin, cos, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    labels, affine = mapped
    turned = SHEET | {
        "landmarks": {"body": {"part": "bile", "radius": 12}},
        "views": {
            "GBL": {
                "pose": {
                    "focus": (turn[:3, :3] @ (1.0, 34.5, -69.0)).tolist(),
                    "beam": [0.0, 0.0, -1.0],
                    "right": (turn[:3, :3] @ (1.0, -0.2, 0.0)).tolist(),
                },
                "shows": {"body": 1},
            }
        },
    }
    sheet = organs.write_sheet(tmp_path / "gallbladder.yaml", turned)
    from_labels(save(tmp_path / "map.nii", labels, turn @ affine), sheet, tmp_path / "out")
    points = torch.rand(500, 3, dtype=torch.float64) * 0.1 - torch.tensor([0.05, 0.05, 0.12])
    moved = points @ torch.from_numpy(turn[:3, :3]).T
    alike = read_saved(tmp_path / "out").number_at(moved) == phantom.number_at(points)
    assert float(alike.float().mean()) > 0.99


def _refused(tmp_path: Path, path: Path, sheet: dict[str, Any], told: str) -> None:
    written = organs.write_sheet(tmp_path / "gallbladder.yaml", sheet)
    with pytest.raises(RacinesError, match=told):
        from_labels(path, written, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_map_without_a_usable_affine_is_refused(mapped: tuple, tmp_path: Path):
    labels, affine = mapped
    bare = save(tmp_path / "bare.nii.gz", labels, None)
    _refused(tmp_path, bare, SHEET, r"bare\.nii\.gz: no affine \(sform_code and qform_code are 0\)")
    flat = affine.copy()
    flat[:, 1] = 0.0
    image = nibabel.Nifti1Image(labels, affine)
    image.header.set_sform(flat, 1)
    image.header["qform_code"] = 0
    nibabel.save(image, tmp_path / "flat.nii")
    raw = bytearray((tmp_path / "flat.nii").read_bytes())
    np.frombuffer(raw, "<f4", 12, 280)[:] = flat[:3].ravel()  # srow_x, srow_y, srow_z
    (tmp_path / "flat.nii").write_bytes(raw)
    _refused(tmp_path, tmp_path / "flat.nii", SHEET, r"flat\.nii: its affine cannot be inverted")


def test_what_is_no_label_map_of_the_sheet_is_refused(mapped: tuple, tmp_path: Path):
    labels, affine = mapped
    fine = save(tmp_path / "fine.nii.gz", labels, affine)
    lacking = SHEET | {"parts": {k: v for k, v in SHEET["parts"].items() if k != "kidney"}}
    _refused(
        tmp_path, fine, lacking, r"fine\.nii\.gz: label 2 stands in no part of .*gallbladder\.yaml"
    )
    more = SHEET | {"parts": SHEET["parts"] | {"stone": {"label": 9, "tissue": "stone"}}}
    _refused(tmp_path, fine, more, "no voxel has label 9")
    small = affine * np.array([[1e-3]] * 3 + [[1.0]])
    metres = save(tmp_path / "metres.nii.gz", labels, small, "unknown")
    _refused(tmp_path, metres, SHEET, r"spans 0\.\d+ mm .*looks like m: set units: m")
    said = save(tmp_path / "said.nii.gz", labels, small, "meter")
    _refused(tmp_path, said, SHEET, "its header says m, .* says units: mm: correct one")
    shades = save(tmp_path / "shades.nii.gz", labels + np.float32(0.5), affine)
    _refused(tmp_path, shades, SHEET, "no whole numbers: give labels, not intensities")
    film = save(tmp_path / "film.nii.gz", np.stack([labels] * 2, -1), affine)
    _refused(tmp_path, film, SHEET, "4 axes")
    (tmp_path / "torn.nii.gz").write_bytes(fine.read_bytes()[:400])
    _refused(tmp_path, tmp_path / "torn.nii.gz", SHEET, r"torn\.nii\.gz: cannot be read as NIfTI")
    _refused(tmp_path, tmp_path / "absent.nii.gz", SHEET, "no such file")
    mesh = SHEET | {"parts": SHEET["parts"] | {"x": {"mesh": "a.obj", "tissue": "bile"}}}
    _refused(tmp_path, fine, mesh, r"parts\.x\.mesh: a label map has no meshes")


def test_no_fifo_is_waited_for(tmp_path: Path):
    place = r"a FIFO, a socket or a device, where a file is needed"
    with fifo(tmp_path / "map.nii.gz") as path:
        _refused(tmp_path, path, SHEET, rf"map\.nii\.gz: {place}: name a label map, FILE\.nii\.gz")
    with fifo(tmp_path / "own.yaml") as path, pytest.raises(RacinesError) as caught:
        from_labels(tmp_path / "map.nii.gz", path, tmp_path / "out")
    assert str(caught.value) == f"{path}: {place}: name a tissues.yaml (docs/own-anatomy.md)"


def test_a_header_that_claims_more_than_memory_holds_is_not_read(tmp_path: Path):
    header = nibabel.Nifti1Header()
    header.set_data_dtype(np.uint8)
    header.set_data_shape((4000, 4000, 2500))  # 40 GB, and 352 bytes of file
    header.set_sform(np.eye(4), 1)
    (tmp_path / "large.nii").write_bytes(header.binaryblock + b"\0" * 4)
    _refused(
        tmp_path,
        tmp_path / "large.nii",
        SHEET,
        r"large\.nii: its header says 4000×4000×2500 voxels, more than 200,000,000",
    )
