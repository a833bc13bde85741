"""Landmarks, views and place of an organ, in its own frame: that of its file, or a heart's.

A heart's frame is that of the patients' hearts: the origin in the middle of the mitral valve, w to
the apex, u away from the tricuspid valve, v = w x u to the front.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch

from racines_data.errors import RacinesError
from racines_data.own.meshes import Surface
from racines_data.own.sheet import Sheet, View
from racines_data.phantom.acquisition import coordinates
from racines_data.phantom.anatomy import Structure, ViewSpec
from racines_data.phantom.config import PhantomConfig
from racines_data.phantom.heart import DOWN, HEADING
from racines_data.phantom.truth import nominal_pose

MM = 1e-3
SIZES = 10.0, 400.0
"""Span of an organ, mm: what lies outside is taken for a wrong unit."""
HELD = 0.98
"""Share of an organ that has to lie in the block."""


@dataclass(frozen=True)
class Marks:
    """Named points of an organ, and the planes they name; lengths in m."""

    structures: tuple[Structure, ...]
    views: tuple[ViewSpec, ...]


def check_span(points: np.ndarray, sheet: Sheet, what: str) -> None:
    """Refuse an organ whose size tells of another unit.

    Args:
        points: (M, 3) mm, the unit of the YAML applied.
        sheet: the YAML.
        what: the file.
    """
    span = float((points.max(0) - points.min(0)).max())
    low, high = SIZES
    if low <= span <= high:
        return
    factors = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
    own = factors[sheet.head.units]
    fits = [unit for unit, each in factors.items() if low <= span / own * each <= high]
    likely = (
        f"it looks like {' or '.join(fits)}: set units: {fits[0]}" if fits else "look at its file"
    )
    raise RacinesError(
        f"{what}: spans {span:g} mm with units: {sheet.head.units}, organs {low:g} to {high:g}: "
        f"{likely}"
    )


def places(
    sheet: Sheet, surfaces: Mapping[str, Surface], parts: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Return the (3,) places of the landmarks in the file's frame, mm.

    Args:
        sheet: the YAML.
        surfaces: of the parts that are meshes.
        parts: the middles of parts that are known; landmarks of others are left out.
    """
    found: dict[str, np.ndarray] = {}
    rims = {rim: surface.rim(rim) for surface in surfaces.values() for rim in surface.rims}
    for name, mark in sheet.landmarks.items():
        if mark.at is not None:
            found[name] = np.array(mark.at, float)
        elif mark.rim:
            found[name] = rims[mark.rim]
        elif mark.part in parts:
            found[name] = parts[mark.part]
    return found


def heart_turn(sheet: Sheet, found: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the (3, 4) rigid map from the file's frame to a heart's, mm.

    Raises:
        RacinesError: a landmark that is the middle of a part, or three on one line.
    """
    assert sheet.heart is not None
    for key, name in asdict(sheet.heart).items():
        if name not in found:
            raise sheet.refuse(
                f"heart.{key}", f"landmark {name!r}: give it by at or rim, not by part"
            )
    base, apex, right = (found[name] for name in asdict(sheet.heart).values())
    w = apex - base
    u = base - right
    u = u - (u @ w) / (w @ w) * w
    if not np.linalg.norm(u) > 5.0 or not np.linalg.norm(w) > 5.0:
        raise sheet.refuse("heart", "base, apex and right lie on one line: name three that do not")
    u, w = u / np.linalg.norm(u), w / np.linalg.norm(w)
    axes = np.stack([u, np.cross(w, u), w])
    return np.column_stack([axes, -axes @ base])


def marks_of(sheet: Sheet, found: Mapping[str, np.ndarray], turn: np.ndarray) -> Marks:
    """Return structures and views in the organ's frame, m."""
    placed = {name: turn[:, :3] @ point + turn[:, 3] for name, point in found.items()}
    structures = tuple(
        Structure(name, _point(placed[name] * MM), mark.radius * MM)
        for name, mark in sheet.landmarks.items()
    )
    views = tuple(_view(sheet, name, view, placed, turn) for name, view in sheet.views.items())
    return Marks(structures, views)


def _view(
    sheet: Sheet, name: str, view: View, placed: Mapping[str, np.ndarray], turn: np.ndarray
) -> ViewSpec:
    if view.pose:
        focus = turn[:, :3] @ np.array(view.pose["focus"]) + turn[:, 3]
        beam, right = (turn[:, :3] @ np.array(view.pose[key]) for key in ("beam", "right"))
    else:
        focus = placed[view.focus]
        beam = placed[view.beam[1]] - placed[view.beam[0]]
        right = placed[view.right] - focus
    # The picture's right is x, the beam z: y, the normal, is z x x.
    normal = np.cross(beam, right)
    if not np.linalg.norm(normal) > 1e-3 * np.linalg.norm(beam) * np.linalg.norm(right) > 0:
        raise sheet.refuse(f"views.{name}", "beam and right lie on one line: they make no plane")
    return ViewSpec(
        name=name,
        focus=_point(focus * MM),
        beam=_point(beam / np.linalg.norm(beam)),
        normal=_point(normal / np.linalg.norm(normal)),
        structures=tuple(view.shows.items()),
        indentation=view.indentation * MM,
        title=view.title,
    )


def _point(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 9) for value in values)
    return x, y, z


def place_of(
    sheet: Sheet, points: np.ndarray, marks: Marks, config: PhantomConfig | None = None
) -> dict[str, Any]:
    """Return how an organ lies in the block: `axes`, `origin`, `home` and `wander` of an `Anatomy`.

    Args:
        sheet: the YAML.
        points: (M, 3) mm, all of the organ, its own frame.
        marks: its views.
        config: of the phantom; the default one.

    Raises:
        RacinesError: directions that make no axes, or an organ that the block cannot hold.
    """
    config = config or PhantomConfig()
    up, ahead, depth, middle = _laid(sheet)
    up = up / np.linalg.norm(up)
    ahead = ahead - (ahead @ up) * up
    if not np.linalg.norm(ahead) > 1e-6:
        raise sheet.refuse("place", "up and ahead are one direction: name another ahead")
    ahead = ahead / np.linalg.norm(ahead)
    axes = np.column_stack([ahead, np.cross(up, ahead), up])  # rows: the organ's axes in the base
    base = points * MM @ axes
    centre = (base.max(0) + base.min(0)) / 2.0
    surface = config.block.maximum[2]
    origin = np.array(
        [*(np.array(middle) * MM - centre[:2]), surface - depth * MM - base[:, 2].max()]
    )
    low, high = np.array(config.block.minimum), np.array(config.block.maximum)
    held = ((base + origin > low) & (base + origin < high)).all(1).mean()
    if held < HELD:
        size = ", ".join(f"{1e3 * (b - a):.0f}" for a, b in zip(low, high, strict=True))
        raise sheet.refuse("place", f"{100 * (1 - held):.0f} % of the organ lies outside the block "
                           f"({size} mm): turn it, or give depth, x and y")  # fmt: skip
    poses = [
        nominal_pose(view, torch.tensor(axes), torch.tensor(origin), surface)
        for view in marks.views
    ]
    seen = torch.stack([coordinates(type(p)(p.position[None], p.rotation[None]))[0] for p in poses])
    turns = seen[:, 5]
    turn = math.atan2(float(turns.sin().mean()), float(turns.cos().mean()))
    mean = [round(float(value), 4) for value in seen.mean(0)]
    return {
        "axes": [list(_point(row)) for row in axes],
        "origin": list(_point(origin)),
        "home": [mean[0], mean[1], 0.0, mean[3], mean[4], round(turn, 4)],
        "wander": [mean[0], mean[1], round(turn, 4)],
    }


def _laid(sheet: Sheet) -> tuple[np.ndarray, np.ndarray, float, tuple[float, float]]:
    """Return what faces up and ahead, depth and middle, mm; a heart lies as the built-in one."""
    place = sheet.place
    if sheet.heart is None:
        return (
            np.array(place.up, float),
            np.array(place.ahead, float),
            place.depth,
            (place.x, place.y),
        )
    up = -np.array(DOWN)
    up = up / np.linalg.norm(up)
    forward = np.array([0.0, 0.0, 1.0])
    forward = forward - (forward @ up) * up
    forward = forward / np.linalg.norm(forward)
    side = np.cross(up, forward)
    ahead = math.cos(HEADING) * forward - math.sin(HEADING) * side
    return up, ahead, place.depth, (place.x, place.y)
