"""Surfaces of triangles from files: welded, closed at the rims that are named, all phases alike.

OBJ, PLY and STL are read by `trimesh`, VTK by `meshio` (extra `racines[anatomy]`). Sheets of a
model may share an edge by position alone: vertices at one place are made one, by the first phase,
and so in all others, since the vertices of one surface go with the same tissue in all phases.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from racines_data.errors import RacinesError
from racines_data.extras import needed
from racines_data.own.sheet import UNITS, Part, Sheet
from racines_data.sources.table.inputs import open_folder

PHASE = "{phase}"
BY_TRIMESH, BY_MESHIO = (".obj", ".ply", ".stl"), (".vtk", ".vtu")
DIGITS = 4
"""Vertices that agree to so many decimals of a millimetre are one."""


@dataclass(frozen=True)
class Surface:
    """One part's surface, closed, over the phases."""

    vertices: np.ndarray
    """(P, V, 3) float64, mm; the last are the middles of the rims, in their order."""
    faces: np.ndarray
    """(F, 3) int64, turned alike."""
    open_edges: int
    """In the file, seams included."""
    seams: int
    """Open edges of the file whose two sides lie on each other."""
    rims: dict[str, int]
    """Edges of the rims that were closed, by name."""
    files: tuple[Path, ...]

    def rim(self, name: str) -> np.ndarray:
        """Return the (3,) middle of a rim at the first phase."""
        return self.vertices[0, list(self.rims).index(name) - len(self.rims)]


def read_surfaces(folder: Path, sheet: Sheet) -> dict[str, Surface]:
    """Return the closed surface of each part that is a mesh.

    Raises:
        RacinesError: a file that is absent or holds no triangles, phases that do not go together,
            a surface that is open where no cap is asked for or has other rims than are named.
    """
    found = {}
    for name, part in sheet.parts.items():
        if part.mesh:
            found[name] = _read_part(folder, sheet, name, part)
    counts = {
        name: len(each.files) for name, each in found.items() if PHASE in sheet.parts[name].mesh
    }
    if len(set(counts.values())) > 1:
        told = ", ".join(f"{name} {count}" for name, count in counts.items())
        raise sheet.refuse("parts", f"files of unlike numbers of phases: {told}")
    return found


def _read_part(folder: Path, sheet: Sheet, name: str, part: Part) -> Surface:
    files = _files(folder, sheet, name, part.mesh)
    scale = UNITS[sheet.head.units]
    first, faces = read_mesh(files[0])
    kept, same = _one_a_place(first * scale)
    frames = [first[kept] * scale]
    for path in files[1:]:
        points, others = read_mesh(path)
        if points.shape != first.shape or not np.array_equal(others, faces):
            raise RacinesError(
                f"{path}: {len(points)} vertices and {len(others)} faces, or other ones than those "
                f"of {files[0].name}: the phases of a part need the same faces in the same order"
            )
        frames.append(points[kept] * scale)
    open_edges = len(_rim_edges(faces))
    faces = same[faces]
    faces = _turned_alike(files[0], faces[(faces != np.roll(faces, 1, 1)).all(1)])
    return _closed(np.stack(frames), faces, open_edges, part, files)


def _files(folder: Path, sheet: Sheet, name: str, pattern: str) -> tuple[Path, ...]:
    """Return the files of a part, in the order of the phases."""
    where = f"parts.{name}.mesh"
    if Path(pattern).is_absolute() or ".." in Path(pattern).parts:
        raise sheet.refuse(where, f"{pattern}: name a file in the folder")
    within, told = open_folder(folder), f"{sheet.path}: {where}"
    if PHASE not in pattern:
        return (within.file(pattern, told),)
    before, _, after = pattern.partition(PHASE)
    form = re.compile(rf"{re.escape(before)}(\d+){re.escape(after)}")
    found = {
        int(match[1]): path
        for path in sorted(folder.glob("*"))
        if (match := form.fullmatch(path.name))
    }
    if not found:
        raise sheet.refuse(where, f"{folder / pattern}: no file of that name for any phase")
    if sorted(found) != list(range(min(found), min(found) + len(found))):
        absent = sorted(set(range(min(found), max(found))) - set(found))
        raise sheet.refuse(
            where, f"phase {absent[0]} is missing among {min(found)} to {max(found)}"
        )
    return tuple(within.file(found[number].name, told) for number in sorted(found))


def read_mesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the (V, 3) float64 vertices of a file, as they stand there, and its (F, 3) triangles.

    Raises:
        RacinesError: a kind that is not known, a library that is missing, or no finite triangles.
    """
    kind, what = path.suffix.lower(), f"{path}: a mesh"
    if kind not in (*BY_TRIMESH, *BY_MESHIO):
        known = ", ".join((*BY_TRIMESH, *BY_MESHIO))
        raise RacinesError(f"{path}: {kind or 'no ending'} is no kind of mesh: give one of {known}")
    library = needed("trimesh" if kind in BY_TRIMESH else "meshio", what)
    try:
        if kind in BY_TRIMESH:
            mesh = library.load(path, process=False, force="mesh")
            points, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64)
        else:
            mesh = library.read(path)
            triangles = [block.data for block in mesh.cells if block.type == "triangle"]
            points = np.asarray(mesh.points, float)
            faces = np.concatenate(triangles).astype(np.int64) if triangles else np.zeros((0, 3))
    except (
        Exception,
        SystemExit,
    ) as error:  # libraries that raise anything; one leaves the program
        raise RacinesError(f"{path}: cannot be read ({error}): export it again") from error
    if not len(faces) or points.shape[1:] != (3,) or not np.isfinite(points).all():
        raise RacinesError(f"{path}: no finite triangles: export a surface of triangles")
    return points, faces


def _one_a_place(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices to keep, in their order, and which of them each vertex becomes."""
    _, first, same = np.unique(
        np.round(points, DIGITS), axis=0, return_index=True, return_inverse=True
    )
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[same.reshape(-1)]


def _rim_edges(faces: np.ndarray) -> np.ndarray:
    """Return the (E, 2) edges that have a face on one side alone."""
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, counts = np.unique(edges, axis=0, return_counts=True)
    return edges[counts == 1]


def _turned_alike(path: Path, faces: np.ndarray) -> np.ndarray:
    """Return faces that neighbours run along in opposite ways: sheets may face each other."""
    trimesh = needed("trimesh", f"{path}: a mesh")
    mesh = trimesh.Trimesh(np.zeros((faces.max() + 1, 3)), faces, process=False)
    needed("networkx", f"{path}: a mesh")
    trimesh.repair.fix_winding(mesh)
    return np.asarray(mesh.faces, np.int64)


def _closed(
    frames: np.ndarray, faces: np.ndarray, open_edges: int, part: Part, files: tuple[Path, ...]
) -> Surface:
    """Close each rim by a fan about its middle."""
    rims = _rims(frames[0], faces)
    total = sum(map(len, rims))
    if len(rims) != len(part.cap):
        wide = ", ".join(f"{len(rim)} edges {_width(frames[0], rim):.0f} mm wide" for rim in rims)
        asked = f"cap names {len(part.cap)}" if part.cap else "no cap is asked for"
        remedy = "close it, or name its rims, widest first: cap: [NAME, …]"
        if not rims:
            wide, remedy = "closed", "leave out cap"
        raise RacinesError(
            f"{files[0]}: open at {total} rim edges on {len(rims)} rims ({wide}), and {asked}: "
            f"{remedy}"
        )
    caps, middles, count = [faces], [], frames.shape[1]
    for rim in rims:
        middles.append(frames[:, np.unique(rim)].mean(1))
        # Against the way that the faces run, so that the cap is turned as they are.
        caps.append(np.column_stack([rim[:, ::-1], np.full(len(rim), count)]))
        count += 1
    points = np.concatenate([frames, np.stack(middles, 1)], 1) if rims else frames
    names = {name: len(rim) for name, rim in zip(part.cap, rims, strict=True)}
    return Surface(points, np.concatenate(caps), open_edges, open_edges - total, names, files)


def _rims(points: np.ndarray, faces: np.ndarray) -> list[np.ndarray]:
    """Return the (E, 2) edges of each rim as its faces run along them, the widest rim first."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    edges = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    alone = {(a, b) for a, b in _rim_edges(faces).tolist()}
    edges = np.array([e for e in edges.tolist() if (min(e), max(e)) in alone]).reshape(-1, 2)
    if not len(edges):
        return []
    graph = coo_array((np.ones(len(edges)), edges.T), shape=(len(points), len(points)))
    number = connected_components(graph, directed=False)[1][edges[:, 0]]
    rims = [edges[number == each] for each in np.unique(number)]
    return sorted(rims, key=lambda rim: -_width(points, rim))


def _width(points: np.ndarray, rim: np.ndarray) -> float:
    ring = points[np.unique(rim)]
    return 2.0 * float(np.linalg.norm(ring - ring.mean(0), axis=1).mean())


def told_of(surface: Surface) -> Mapping[str, Any]:
    """Return what the card says of how a surface was closed."""
    told: dict[str, Any] = {"files": [path.name for path in surface.files]}
    return told | {
        "open_edges": surface.open_edges, "seams": surface.seams, "caps": dict(surface.rims),
    }  # fmt: skip
