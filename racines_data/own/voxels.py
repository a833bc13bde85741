"""Parts painted on a grid of voxels: surfaces, ellipsoids, and layers about what is there.

Whether a voxel's centre lies in a closed surface is counted along the columns of the grid: each
triangle above a column adds or takes one, by the way it faces, so that sheets that overlap do no
harm. Own code, since what mesh libraries offer marks surface voxels, which is half a voxel too much
all round, or casts a ray a point; and so the same on every processor.
"""

from typing import Any, NamedTuple

import numpy as np

from racines_data.config import fill
from racines_data.own.meshes import Surface
from racines_data.own.sheet import Ellipsoid, Part, Sheet


class Grid(NamedTuple):
    """Voxels along the axes of a frame."""

    low: np.ndarray
    """(3,) mm, centre of the first voxel."""
    edges: np.ndarray
    """(3,) mm."""
    shape: tuple[int, int, int]

    @property
    def affine(self) -> np.ndarray:
        """The (3, 4) map from an index to the mm of its centre."""
        return np.column_stack([np.diag(self.edges), self.low])

    def axes(self) -> list[np.ndarray]:
        """Return the mm of the centres along each axis."""
        return [
            a + d * np.arange(n) for a, d, n in zip(self.low, self.edges, self.shape, strict=True)
        ]


def grid_about(points: np.ndarray, voxel: float, margin: float) -> Grid:
    """Return a grid that holds (M, 3) points and a margin, mm."""
    low = np.floor((points.min(0) - margin) / voxel) * voxel + 0.5 * voxel
    shape = np.ceil((points.max(0) + margin - low) / voxel).astype(int) + 1
    return Grid(low, np.full(3, float(voxel)), (int(shape[0]), int(shape[1]), int(shape[2])))


def inside(vertices: np.ndarray, faces: np.ndarray, grid: Grid) -> np.ndarray:
    """Return (X, Y, Z) bool: whose centres lie in a closed surface.

    Args:
        vertices: (V, 3) mm, in the grid's frame.
        faces: (F, 3), turned alike.
        grid: the voxels.
    """
    # In voxels; a column that runs through an edge belongs to one of its two faces (see `_beside`).
    place = (vertices - grid.low) / grid.edges
    crossings, heights, ways = _crossings(place, faces, grid.shape)
    turns = np.zeros((*grid.shape[:2], grid.shape[2] + 1), np.int32)
    level = np.clip(np.ceil(heights), 0, grid.shape[2]).astype(np.int64)
    np.add.at(turns, (*crossings, level), ways)
    return np.cumsum(turns, axis=2)[..., :-1] != 0


def _crossings(
    place: np.ndarray, faces: np.ndarray, shape: tuple[int, int, int]
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray]:
    """Return where columns cross faces: columns, heights in voxels, and 1 or -1 by the face."""
    flat = place[:, :2]
    corners = flat[faces]
    low = np.maximum(np.ceil(corners.min(1)), 0).astype(np.int64)
    high = np.minimum(np.floor(corners.max(1)), np.array(shape[:2]) - 1).astype(np.int64)
    size = np.maximum(high - low + 1, 0)
    count = size[:, 0] * size[:, 1]
    face = np.repeat(np.arange(len(faces)), count)
    rank = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    x = low[face, 0] + rank // size[face, 1]
    y = low[face, 1] + rank % size[face, 1]
    sides = [_beside(flat, faces[face, i], faces[face, (i + 1) % 3], x, y) for i in range(3)]
    left = np.stack([positive for positive, _ in sides], 1)
    hit = left.all(1) | ~left.any(1)
    face, x, y = face[hit], x[hit], y[hit]
    weights = np.stack([area for _, area in sides], 1)[hit]
    total = weights.sum(1)
    flat_on = np.where(total == 0.0, 1.0, total)
    height = place[faces[face]][..., 2]
    opposite = np.stack([height[:, 2], height[:, 0], height[:, 1]], 1)
    return (x, y), (weights * opposite).sum(1) / flat_on, np.where(left[hit, 0], 1, -1)


def _beside(
    flat: np.ndarray, a: np.ndarray, b: np.ndarray, x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return on which side of the edges from a to b columns lie, and twice the area to them.

    The edge is taken in one direction from both its faces, so that they agree to the last bit; what
    lies on it counts as left of it in that direction.
    """
    first, second = np.minimum(a, b), np.maximum(a, b)
    start, way = flat[first], flat[second] - flat[first]
    area = way[:, 0] * (y - start[:, 1]) - way[:, 1] * (x - start[:, 0])
    along = a < b
    return (area >= 0.0) == along, np.where(along, area, -area)


def paint(
    sheet: Sheet,
    grid: Grid,
    surfaces: dict[str, Surface],
    turn: np.ndarray,
    labels: np.ndarray | None,
) -> np.ndarray:
    """Return (X, Y, Z) uint8: the number of the part at each voxel, 0 around them.

    Args:
        sheet: says the parts and their order.
        grid: the voxels, in the organ's frame.
        surfaces: of the parts that are meshes, in the file's frame.
        turn: (3, 4), from the file's frame to the organ's, mm, a rigid one.
        labels: what a label map has painted already.
    """
    result = np.zeros(grid.shape, np.uint8) if labels is None else labels.copy()
    numbers = {name: i for i, name in enumerate(sheet.parts, 1)} | {"around": 0}
    for name, part in sheet.parts.items():
        if part.label:
            continue
        if part.mesh:
            points = surfaces[name].vertices[0] @ turn[:, :3].T + turn[:, 3]
            there = inside(points, surfaces[name].faces, grid)
        elif part.ellipsoid:
            there = _in_ellipsoid(sheet, name, part, grid, turn)
        else:
            there = _shell(part, grid, result, numbers)
        if over := part.over or (("around",) if part.shell else ()):
            there &= np.isin(result, [numbers[other] for other in over])
        result[there] = numbers[name]
    return result


def _in_ellipsoid(sheet: Sheet, name: str, part: Part, grid: Grid, turn: np.ndarray) -> np.ndarray:
    values: dict[str, Any] = part.ellipsoid
    shape = fill(Ellipsoid, values, f"parts.{name}.ellipsoid")
    along, beside = np.array(shape.along, float), np.array(shape.beside, float)
    across = np.cross(along, beside)
    if min(shape.radii) <= 0 or not np.linalg.norm(across) > 1e-6 * np.linalg.norm(along):
        raise sheet.refuse(f"parts.{name}.ellipsoid", "radii above 0, and two directions apart")
    along, across = along / np.linalg.norm(along), across / np.linalg.norm(across)
    axes = np.stack([along, np.cross(across, along), across]) @ turn[:, :3].T
    centre = turn[:, :3] @ np.array(shape.at) + turn[:, 3]
    x, y, z = (each - middle for each, middle in zip(grid.axes(), centre, strict=True))
    square = np.zeros(grid.shape)
    for axis, radius in zip(axes, shape.radii, strict=True):
        length = axis[0] * x[:, None, None] + axis[1] * y[:, None] + axis[2] * z
        square += (length / radius) ** 2
    return square < 1.0


def _shell(part: Part, grid: Grid, result: np.ndarray, numbers: dict[str, int]) -> np.ndarray:
    """Return the voxels within a thickness of some parts."""
    from scipy.ndimage import distance_transform_edt

    about = np.isin(result, [numbers[other] for other in part.shell])
    if not about.any():
        return about
    away: Any = distance_transform_edt(~about, sampling=grid.edges)
    # The surface lies before the nearest centre by half a voxel along an axis, by less across them.
    return ~about & (away <= part.thickness + 0.25 * float(np.mean(grid.edges)))


def volume(result: np.ndarray, number: int, grid: Grid) -> float:
    """Return what a part fills, mL."""
    return float((result == number).sum() * np.prod(grid.edges) / 1e3)


def middle(result: np.ndarray, number: int, grid: Grid) -> np.ndarray:
    """Return the (3,) mean place of a part, mm."""
    index = np.argwhere(result == number)
    return index.mean(0) * grid.edges + grid.low
