"""Where the pixels of an image lie about the probe, in millimetres, if it is known.

A simulated image has its apex at the probe's face, in the middle of the first row, and its pixels
are square. How large they are is the scanner's setting, a patient's own. Of recordings it is known
where somebody states it; where nobody does, no error in millimetres of a pixel can be told.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE
from racines_data.patients.form import shape_of
from racines_data.patients.placement import depth_to_hold, geometric_poses, place
from racines_data.patients.population import draw_patient
from racines_data.phantom.config import ProbeConfig
from racines_data.store.frames import FrameStore

NUMBERS = 9
"""Of a plane: where the first pixel lies, and the steps to the next column and the next row."""
LARGEST = 5.0
"""Side of a pixel beyond which a picture would be wider than any body, mm."""


@dataclass(frozen=True)
class Plane:
    """Where pixels lie in the probe's frame; (3,) float64 each, mm."""

    origin: Tensor
    """Middle of the first pixel."""
    across: Tensor
    """From a column to the next."""
    down: Tensor
    """From a row to the next."""

    def points(self, columns: Tensor, rows: Tensor) -> Tensor:
        """Return the (…, 3) places, mm, of (…,) columns and rows."""
        columns, rows = columns.double().unsqueeze(-1), rows.double().unsqueeze(-1)
        return self.origin + columns * self.across + rows * self.down


def sector_plane(pixel: float) -> Plane:
    """Return the plane of an image with the probe in the middle of its first row; pixels in mm."""
    aside = (IMAGE_SIZE - 1) / 2
    places = (-aside * pixel, 0.0, 0.5 * pixel), (pixel, 0.0, 0.0), (0.0, 0.0, pixel)
    return Plane(*(torch.tensor(each, dtype=torch.float64) for each in places))


def stated_plane(numbers: Sequence[float], where: str) -> Plane:
    """Return the plane of nine numbers, mm (see `NUMBERS`).

    Raises:
        RacinesError: not nine, or two steps that span no plane of pixels.
    """
    if len(numbers) != NUMBERS or not all(math.isfinite(each) for each in numbers):
        told = "the first pixel's place, the step to the next column, to the next row, mm"
        raise RacinesError(f"{where}: {list(numbers)}: give nine numbers: {told}")
    plane = Plane(*torch.tensor(numbers, dtype=torch.float64).view(3, 3).unbind(0))
    sides = [float(each.norm()) for each in (plane.across, plane.down)]
    spanned = float(torch.linalg.cross(plane.across, plane.down).norm())
    if not 0.0 < min(sides) <= max(sides) <= LARGEST or spanned < 0.5 * sides[0] * sides[1]:
        told = f"steps of {sides[0]:.3g} and {sides[1]:.3g} mm across one another"
        raise RacinesError(f"{where}: {told}: give steps of pixels, at most {LARGEST:g} mm")
    return plane


def planes_of(store: FrameStore, rows: Tensor) -> list[Plane] | None:
    """Return the planes of (N,) rows' images, or None where the data do not tell them."""
    recipe: dict[str, Any] = store.manifest.get("recipe") or {}
    settings = recipe.get("settings") or {}
    if store.patients is not None and recipe and "own" not in settings:
        return [sector_plane(pixel_of(int(seed))) for seed in store.units(rows).tolist()]
    if store.manifest.get("source") == "phantom" and recipe:
        phantom = (settings.get("acquisition") or {}).get("phantom") or {}
        config = fill(ProbeConfig, phantom.get("probe") or {}, "recipe.probe")
        return [sector_plane(_pixel(config.depth, config.half_angle))] * len(rows)
    return None


@lru_cache(maxsize=4096)
def pixel_of(seed: int) -> float:
    """Return the side, mm, of the pixels of a simulated patient, as `Pool.pixel_size` does.

    No heart is baked and no view is searched for it.
    """
    patient = draw_patient(seed)
    shape = shape_of(patient.form)
    lies = place(shape, patient)
    exam = patient.examination
    depth = depth_to_hold(shape, lies, geometric_poses(shape, lies), exam.margin)
    return _pixel(depth, exam.half_angle)


def _pixel(depth: float, half_angle: float) -> float:
    return depth * 1e3 * 2.0 * math.sin(half_angle) / IMAGE_SIZE
