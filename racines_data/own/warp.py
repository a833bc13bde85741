"""How a heart moves: a smooth map of each phase, from where its tissue is to where it was at first.

    vertices of all surfaces, phase p  ->  thin-plate spline through their ways back to phase 0
                                       ->  sampled every 5 mm; between phases by time, linearly

The vertices of a surface go with the same tissue in all phases, so the map is fitted, not modelled;
what lies between and beyond surfaces follows smoothly, and at the edge of the box nothing moves.
Thin-plate splines: Bookstein, IEEE TPAMI 1989; fitted with a little smoothing, and measured: how
far vertices end from where they were, and that the map can be inverted.
"""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.own.meshes import Surface

SPACING = 5.0
"""From node to node of the sampled map, mm."""
APART = 4.0
"""Vertices nearer than this to one that the spline goes by are left to it, mm."""
SMOOTHING = 0.5
STILL = 6
"""Points along an edge of the box, whose faces stay where they are."""
LEAST = 0.01
"""Jacobian below which a map counts as folded."""


class Warp(NamedTuple):
    """Of P phases over a beat, in a heart's frame."""

    back: Tensor
    """(P, X, Y, Z, 3) float32 mm: from a place at a phase to where its tissue was at the first."""
    low: tuple[float, float, float]
    """Of the first node, mm."""

    def before(self, points: Tensor, moment: Tensor) -> Tensor:
        """Return where (B, ..., 3) float64 points were at the first phase.

        Args:
            points: mm.
            moment: (B,) float64 phases in [0, P); the last goes on to the first.
        """
        return points + sample(self, points.flatten(1, -2), moment).view(points.shape)

    def now(self, points: Tensor, moment: Tensor, steps: int = 40) -> Tensor:
        """Return where (B, N, 3) points of the first phase are: the inverse, by iteration."""
        found = points.clone()
        for _ in range(steps):
            found = found + 0.6 * (points - self.before(found, moment))
        return found


def sample(warp: Warp, points: Tensor, moment: Tensor) -> Tensor:
    """Return the (B, N, 3) float64 ways of points: trilinear in space, linear in time."""
    phases, *size = warp.back.shape[:4]
    field = warp.back.flatten(0, 3)
    place = (points - points.new_tensor(warp.low)) / SPACING
    last = points.new_tensor([n - 1.0 for n in size])
    place = torch.minimum(place.clamp_min(0.0), last)
    corner = torch.minimum(place.floor(), last - 1.0)
    share = place - corner
    first = moment.floor()
    when = torch.stack([first, first + 1.0]).long().remainder(phases)
    late = (moment - first).view(-1, 1, 1)
    at = corner.long()
    result = torch.zeros_like(points)
    for side in range(2):
        start = when[side].view(-1, 1)
        part = torch.zeros_like(points)
        for bits in range(8):
            step = [(bits >> axis) & 1 for axis in range(3)]
            index = start
            for axis in range(3):
                index = index * size[axis] + at[..., axis] + step[axis]
            weight = torch.ones_like(share[..., 0])
            for axis in range(3):
                weight = weight * (share[..., axis] if step[axis] else 1.0 - share[..., axis])
            value = field.index_select(0, index.flatten()).view(*index.shape, 3).to(points)
            part = part + value * weight.unsqueeze(-1)
        result = result + part * (late if side else 1.0 - late)
    return result


class Fitted(NamedTuple):
    """A warp, and how well it goes by the vertices."""

    warp: Warp
    mean: float
    """Distance of a vertex from where it was, after the map back, mm, over all phases."""
    p95: float
    jacobian: float
    """The least, 1 where nothing changes its volume, at or below 0 where the map folds."""


def fit(
    surfaces: dict[str, Surface], turn: np.ndarray, low: np.ndarray, size: np.ndarray
) -> Fitted:
    """Fit a warp to the surfaces of all phases.

    Args:
        surfaces: in the file's frame; those of one phase stand still and have no say.
        turn: (3, 4), to the heart's frame.
        low: (3,) corner of the box in which the heart lies, mm.
        size: (3,) of the box, mm.

    Raises:
        RacinesError: a map that folds: phases whose vertices do not go together.
    """
    moving = [each.vertices for each in surfaces.values() if len(each.vertices) > 1]
    points = np.concatenate(moving, 1) @ turn[:, :3].T + turn[:, 3]
    chosen = _thinned(points[0])
    sides = [np.linspace(a, a + d, STILL) for a, d in zip(low, size, strict=True)]
    still = np.stack(np.meshgrid(*sides, indexing="ij"), -1).reshape(-1, 3)
    still = still[((still == low) | np.isclose(still, low + size)).any(1)]
    count = np.ceil(size / SPACING).astype(int) + 1
    axes = [a + SPACING * np.arange(n) for a, n in zip(low, count, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    back = np.stack([_back(points[0], each, chosen, still, nodes) for each in points])
    back[0] = 0.0
    x, y, z = (float(each) for each in low)
    warp = Warp(torch.from_numpy(back.astype(np.float32)), (x, y, z))
    every = torch.from_numpy(points)
    moments = torch.arange(len(points), dtype=torch.float64)
    off = (warp.before(every, moments) - every[:1]).norm(dim=-1).numpy()
    slopes = np.stack([np.gradient(nodes + each, SPACING, axis=(0, 1, 2)) for each in back])
    jacobian = float(np.linalg.det(np.moveaxis(slopes, 1, -1)).min())
    if jacobian < LEAST:
        raise RacinesError(
            f"{next(iter(surfaces.values())).files[0].parent}: the motion between phases folds "
            f"(Jacobian {jacobian:.2f}): vertices of one surface have to stay with the same tissue "
            "in all phases; leave {phase} out for a heart that stands still"
        )
    return Fitted(warp, float(off.mean()), float(np.quantile(off, 0.95)), jacobian)


def _thinned(points: np.ndarray) -> np.ndarray:
    """Return indices of points, none of them within `APART` of another, in their order."""
    from scipy.spatial import KDTree

    tree, free, chosen = KDTree(points), np.ones(len(points), bool), []
    for index in range(len(points)):
        if free[index]:
            chosen.append(index)
            free[tree.query_ball_point(points[index], APART)] = False
    return np.array(chosen)


def _back(
    first: np.ndarray, now: np.ndarray, chosen: np.ndarray, still: np.ndarray, nodes: np.ndarray
) -> np.ndarray:
    """Return the (X, Y, Z, 3) ways back at the nodes."""
    from scipy.interpolate import RBFInterpolator

    known = np.concatenate([now[chosen], still])
    ways = np.concatenate([first[chosen] - now[chosen], np.zeros_like(still)])
    spline = RBFInterpolator(known, ways, kernel="thin_plate_spline", smoothing=SMOOTHING, degree=1)
    return spline(nodes.reshape(-1, 3)).reshape(nodes.shape)
