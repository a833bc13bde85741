"""Signed distances of the shapes that organs are made of: negative inside, metres.

Source of the formulae: Quilez, Distance functions (the ellipsoid is the usual first-order bound,
exact on its surface).
"""

from collections.abc import Sequence

import torch
from torch import Tensor

Point = Sequence[float]


def ellipsoid(
    points: Tensor, centre: Point, radii: Point, axes: Sequence[Point] | None = None
) -> Tensor:
    """Distance of (M, 3) points to an ellipsoid; `axes` are its unit axes (rows), else xyz."""
    local = points - points.new_tensor(centre)
    if axes is not None:
        local = local @ points.new_tensor(axes).T
    scale = points.new_tensor(radii)
    k0 = (local / scale).norm(dim=-1)
    k1 = (local / scale.square()).norm(dim=-1).clamp_min(1e-9)
    return k0 * (k0 - 1.0) / k1


def capsule(points: Tensor, a: Point, b: Point, radius_a: float, radius_b: float) -> Tensor:
    """Distance to a capsule from a to b whose radius changes linearly (to first order)."""
    start = points.new_tensor(a)
    axis = points.new_tensor(b) - start
    along = ((points - start) @ axis / axis.square().sum()).clamp(0.0, 1.0)
    nearest = start + along.unsqueeze(-1) * axis
    return (points - nearest).norm(dim=-1) - (radius_a + along * (radius_b - radius_a))


def tube(points: Tensor, path: Sequence[Point], radii: Sequence[float]) -> Tensor:
    """Distance to a tube along a polyline, one radius a vertex."""
    parts = [
        capsule(points, path[i], path[i + 1], radii[i], radii[i + 1]) for i in range(len(path) - 1)
    ]
    return union(*parts)


def union(*distances: Tensor) -> Tensor:
    """Join shapes."""
    result = distances[0]
    for distance in distances[1:]:
        result = torch.minimum(result, distance)
    return result


def smooth_union(a: Tensor, b: Tensor, blend: float) -> Tensor:
    """Join two shapes with a fillet of about `blend` metres (polynomial smooth minimum)."""
    h = (0.5 + 0.5 * (b - a) / blend).clamp(0.0, 1.0)
    return torch.lerp(b, a, h) - blend * h * (1.0 - h)


def subtract(a: Tensor, b: Tensor) -> Tensor:
    """Cut shape b out of shape a."""
    return torch.maximum(a, -b)
