"""Poses in the frame of the heart that is scanned, as a dataset's table of measures tells it.

In the base frame a pose says where a probe is on a chest; what is seen there depends on where the
heart lies under it. In the heart's own frame a pose says what is seen: it is comparable between
patients. Breathing moves this frame, the beat does not, and what tissue gives under the probe is
left out.
"""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, rotate
from racines_data.store.frames import FrameStore
from racines_data.world import breathed

SHAPES = {"heart_axes": (3, 3), "heart_origin": (3,), "heart_sway": (3,)}
"""Columns of the table of measures, a list of numbers a patient, and their shapes."""


class Hearts(NamedTuple):
    """Where the hearts of (B,) rows lie when breathed out; float64, base frame."""

    axes: Tensor
    """(B, 3, 3), whose rows are the hearts' axes; the third is the left ventricle's."""
    origin: Tensor
    """(B, 3) m, the middle of the mitral plane."""
    sway: Tensor
    """(B, 3) m, the shift at full breath."""


def columns(axes: Tensor, origin: Tensor, sway: Tensor) -> dict[str, list[float]]:
    """Return the columns of one heart: (3, 3) axes as rows, (3,) origin and (3,) sway, m."""
    values = (axes, origin, sway)
    return {name: each.flatten().tolist() for name, each in zip(SHAPES, values, strict=True)}


def hearts_of(store: FrameStore, rows: Tensor) -> Hearts:
    """Return where the hearts lie that (N,) rows scan.

    Raises:
        RacinesError: no patients are scanned, or the dataset does not say where their hearts lie.
    """
    if store.patients is None:
        raise RacinesError(
            f"config {store.config}: no frame of it belongs to a patient, so none has a pose about "
            "a patient's heart; choose patients or beating"
        )
    people: dict[str, list[Any]] = store.measures().to_pydict()
    missing = [name for name in SHAPES if name not in people]
    if missing:
        raise RacinesError(
            f"{store.root}: measures of config {store.config} lack {', '.join(missing)}, "
            f"where hearts lie; build it anew: racines data build --source "
            f"{store.manifest['source']} --out {store.root}"
        )
    place = {patient: row for row, patient in enumerate(people["patient"])}
    at = torch.tensor([place[patient] for patient in store.units(rows).tolist()])
    found = [
        torch.tensor(people[name], dtype=torch.float64).view(-1, *shape)[at]
        for name, shape in SHAPES.items()
    ]
    return Hearts(*found)


def to_heart(pose: Pose, hearts: Hearts, breath: Tensor | None = None) -> Pose:
    """Return (B,) poses of the base frame, m, in the frames of (B,) hearts, float64.

    Args:
        pose: of the probe; its columns stay the probe's axes.
        hearts: where they lie.
        breath: (B,) respiratory phases in [0, 1); None: breathed out.
    """
    origin = hearts.origin
    if breath is not None:
        origin = origin + breathed(hearts.sway, breath.double())
    position = rotate(hearts.axes, pose.position.double() - origin)
    return Pose(position, hearts.axes @ pose.rotation.double())
