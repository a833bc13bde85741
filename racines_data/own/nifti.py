"""A label map with its affine, from NIfTI through `nibabel` (extra `racines[anatomy]`)."""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from racines_data.errors import RacinesError
from racines_data.extras import needed
from racines_data.own.sheet import UNITS, Sheet
from racines_data.sources.table.inputs import named_file

MOST = 200_000_000
"""Voxels of a label map, 585 along each side: what a header claims beyond that is not read."""


class LabelMap(NamedTuple):
    """Labels by voxel, its axes in the order and the way of the patient's: right, front, head."""

    labels: np.ndarray
    """(X, Y, Z) uint8: the number of the part from 1 up, 0 around them."""
    affine: np.ndarray
    """(3, 4) float64, from a voxel's index to the mm of its centre."""


def read_labels(path: Path, sheet: Sheet) -> LabelMap:
    """Read a label map; its axes are turned and flipped until they run as the patient's do.

    Raises:
        RacinesError: no such file or no NIfTI; no affine, one without inverse, or units that the
            YAML contradicts; no three axes, numbers that are no labels, labels that the YAML lacks
            or names in vain.
    """
    named_file(path, "name a label map, FILE.nii.gz")
    nibabel = needed("nibabel", f"{path}: a label map")
    try:
        image = nibabel.load(path)
        voxels = math.prod(map(int, image.shape))
        values = None if voxels > MOST else np.asanyarray(image.dataobj)
    except Exception as error:  # of many kinds: damaged files raise what they happen to break
        raise RacinesError(f"{path}: cannot be read as NIfTI ({error}): write it again") from error
    if values is None:
        shape = "×".join(map(str, image.shape))
        raise RacinesError(
            f"{path}: its header says {shape} voxels, more than {MOST:,}: resample it"
        )
    _check_affine(path, image, sheet)
    if values.ndim == 4 and values.shape[3] == 1:
        values, image = values[..., 0], image.slicer[..., 0]
    if values.ndim != 3:
        raise RacinesError(f"{path}: {values.ndim} axes {values.shape}: give one label map, X Y Z")
    if not np.isfinite(values).all() or not np.array_equal(values, np.round(values)):
        raise RacinesError(
            f"{path}: values that are no whole numbers: give labels, not intensities"
        )
    canonical = nibabel.as_closest_canonical(image)
    parts = _parts(np.asanyarray(canonical.dataobj).round().astype(np.int64), path, sheet)
    return LabelMap(parts, canonical.affine[:3] * np.float64(UNITS[sheet.head.units]))


def _check_affine(path: Path, image: object, sheet: Sheet) -> None:
    header = image.header  # pyright: ignore[reportAttributeAccessIssue]
    codes = [int(header[name]) for name in ("sform_code", "qform_code") if name in header]
    if not any(codes):
        raise RacinesError(
            f"{path}: no affine (sform_code and qform_code are 0), so nobody knows how large it is "
            "or how it lies: save it with one, e.g. nibabel's img.set_sform(affine, code=1)"
        )
    affine = np.asarray(image.affine, float)  # pyright: ignore[reportAttributeAccessIssue]
    edges = np.linalg.norm(affine[:3, :3], axis=0)
    squared = edges.prod()
    if (
        not np.isfinite(affine).all()
        or abs(np.linalg.det(affine[:3, :3])) < 1e-3 * squared
        or not squared
    ):
        raise RacinesError(f"{path}: its affine cannot be inverted: save it with the scanner's own")
    said = {1: "m", 2: "mm"}.get(int(header["xyzt_units"]) & 7)
    if said and said != sheet.head.units:
        raise RacinesError(
            f"{path}: its header says {said}, {sheet.path} says units: {sheet.head.units}: "
            "correct one"
        )


def _parts(values: np.ndarray, path: Path, sheet: Sheet) -> np.ndarray:
    """Return the numbers of the parts in place of the labels."""
    numbers = {part.label: i for i, part in enumerate(sheet.parts.values(), 1) if part.label}
    there = set(np.unique(values).tolist()) - {0}
    if lacking := sorted(there - set(numbers)):
        told = ", ".join(map(str, lacking[:8]))
        raise RacinesError(f"{path}: label {told} stands in no part of {sheet.path}: add its part")
    if vain := sorted(set(numbers) - there):
        raise RacinesError(f"{path}: no voxel has label {vain[0]}, which {sheet.path} names")
    result = np.zeros(values.shape, np.uint8)
    for label, number in numbers.items():
        result[values == label] = number
    return result
