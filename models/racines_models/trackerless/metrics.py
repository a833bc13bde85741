"""How far an estimated motion is off: the errors of the TUS-REC challenge, and some of the probe.

A point of frame t lies, by the true and by the estimated motion, at two places of the first frame
(global) or of the frame before (local); their distance is its error, in mm. Averaged over all
pixels of all frames but the first, it is GPE or LPE; over landmarks, GLE or LLE. Source:
assessment criteria of TUS-REC 2024 and 2025 (Li et al., https://github-pages.ucl.ac.uk/
tus-rec-challenge), which take displacement vectors; a rigid motion gives them all.

    e(p) = |(R' - R) p + (t' - t)|      p of the image plane about the probe, mm

Where it is not known where pixels lie, errors of the probe remain: how far it is off, and how far
it is turned.
"""

import math

import torch
from torch import Tensor

from racines_data.imaging import IMAGE_SIZE
from racines_models.trackerless.landmarks import Landmarks
from racines_models.trackerless.motion import Motion, angles
from racines_models.trackerless.planes import Plane

PIXELS = ("gpe", "gle", "lpe", "lle")
"""Errors that need to know where pixels lie: global and local, of pixels and of landmarks, mm."""
PROBE = ("drift_mm", "step_mm")
"""Distances of the probe that need metres: at the last frame, and a frame, mm."""
TURNS = ("drift_deg", "step_deg")
"""Angles of the probe that need neither: at the last frame, and a frame, degrees."""
METRICS = PIXELS + PROBE + TURNS
ENDS = {name: (0.0, 180.0 if name in TURNS else math.inf) for name in METRICS}
"""The least and the most that each can be."""


def errors(
    found: Motion, true: Motion, plane: Plane | None, marks: Landmarks, metric: bool = True
) -> dict[str, float]:
    """Return the errors of one sweep by name: `METRICS`, less those that cannot be told.

    Args:
        found: as it was estimated.
        true: as it was.
        plane: where pixels lie; None where it is not known.
        marks: landmarks of the sweep.
        metric: whether lengths are metres; if not, angles alone are told.
    """
    pairs = {"g": (found.to_first, true.to_first), "l": (found.to_previous, true.to_previous)}
    told: dict[str, float] = {}
    if metric and plane is not None:
        for scope, (one, other) in pairs.items():
            off = (one.double() - other.double())[..., :3, :]
            told[f"{scope}pe"] = float(pixel_errors(off[1:], plane).mean())
            told[f"{scope}le"] = float(landmark_errors(off, plane, marks).mean())
    if metric:
        apart = {scope: 1e3 * (a - b)[..., :3, 3].norm(dim=-1) for scope, (a, b) in pairs.items()}
        told |= {"drift_mm": float(apart["g"][-1]), "step_mm": float(apart["l"][1:].mean())}
    turned = {scope: torch.rad2deg(angles(*pair)) for scope, pair in pairs.items()}
    return told | {"drift_deg": float(turned["g"][-1]), "step_deg": float(turned["l"][1:].mean())}


def pixel_errors(off: Tensor, plane: Plane) -> Tensor:
    """Return the (F, 128, 128) errors, mm, of all pixels; `off` is (F, 3, 4), m, of transforms."""
    at, across, down = _moved(off, plane)
    place = torch.arange(IMAGE_SIZE, dtype=torch.float64)
    total = at.new_zeros(len(off), IMAGE_SIZE, IMAGE_SIZE)
    for axis in range(3):  # one at a time: a last axis of three numbers is slow to sum over
        rows = at[:, axis, None] + place * down[:, axis, None]
        columns = place * across[:, axis, None]
        total += (rows.unsqueeze(2) + columns.unsqueeze(1)).square_()
    return total.sqrt_()


def landmark_errors(off: Tensor, plane: Plane, marks: Landmarks) -> Tensor:
    """Return the (L,) errors, mm, of landmarks; `off` is (T, 3, 4), m, of all transforms."""
    at, across, down = (each[marks.frame] for each in _moved(off, plane))
    row, column = marks.row.double().unsqueeze(1), marks.column.double().unsqueeze(1)
    return (at + row * down + column * across).square().sum(-1).sqrt()


def _moved(off: Tensor, plane: Plane) -> tuple[Tensor, Tensor, Tensor]:
    """Return the (F, 3) errors, mm, of the first pixel, and what a column and a row add to it."""
    turn, shift = off[..., :3], off[..., 3] * 1e3

    def turned(vector: Tensor) -> Tensor:
        return (turn * vector).sum(-1)

    return turned(plane.origin) + shift, turned(plane.across), turned(plane.down)
