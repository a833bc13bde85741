"""Surfaces of triangles from OBJ files: welded, closed where they are open, and their volume.

A reader of its own, since an OBJ of one surface is two kinds of lines and closing at a valve is not
what mesh libraries call filling a hole.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from racines_data.errors import RacinesError

WELD = 1e-3
"""Vertices nearer than this are one, mm: sheets of a model share their edge by position."""


class Mesh(NamedTuple):
    """A surface of triangles."""

    vertices: np.ndarray
    """(V, 3) float64, mm."""
    faces: np.ndarray
    """(F, 3) int64."""


def read_obj(path: Path) -> Mesh:
    """Read vertices and faces of a Wavefront OBJ file; faces of more corners become fans.

    Raises:
        RacinesError: absent, no surface, or a line that cannot be read, with its number.
    """
    if not path.is_file():
        raise RacinesError(f"{path}: no such file; give a surface as OBJ")
    vertices: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    for number, line in enumerate(
        path.read_text(encoding="utf-8", errors="replace").splitlines(), start=1
    ):
        kind, *words = line.split() or [""]
        try:
            if kind == "v":
                vertices.append([float(word) for word in words[:3]])
            elif kind == "f":
                first, *others = (_corner(word, len(vertices)) for word in words)
                faces += [(first, a, b) for a, b in zip(others, others[1:], strict=False)]
        except ValueError as error:
            raise RacinesError(f"{path}: line {number}: {error}; export it again") from error
    points = np.array(vertices, float).reshape(-1, 3) if vertices else np.zeros((0, 3))
    if not len(points) or not faces or not np.isfinite(points).all():
        raise RacinesError(f"{path}: no finite vertices (v) and faces (f); export it again")
    return Mesh(points, np.array(faces))


def _corner(word: str, count: int) -> int:
    """Return a corner's vertex from `7`, `7/1/3` or `-1`, counted from 0."""
    given = int(word.partition("/")[0])
    place = given - 1 if given > 0 else count + given
    if not 0 <= place < count or given == 0:
        raise ValueError(f"face names vertex {given} of {count}")
    return place


def welded(mesh: Mesh) -> Mesh:
    """Return the mesh with vertices at one place made one."""
    _, first, same = np.unique(
        np.round(mesh.vertices / WELD), axis=0, return_index=True, return_inverse=True
    )
    return Mesh(mesh.vertices[first], same.reshape(-1)[mesh.faces])


def oriented(mesh: Mesh) -> Mesh:
    """Return the mesh with neighbouring faces turned alike: sheets of a model may face each other.

    Faces that share an edge run along it in opposite ways; what does not is turned over.
    """
    faces = mesh.faces.copy()
    sides: dict[tuple[int, int], list[int]] = {}
    for number, face in enumerate(faces.tolist()):
        for a, b in zip(face, face[1:] + face[:1], strict=True):
            sides.setdefault((min(a, b), max(a, b)), []).append(number)
    seen = np.zeros(len(faces), bool)
    for start in range(len(faces)):
        waiting = [] if seen[start] else [start]
        seen[start] = True
        while waiting:
            face = faces[waiting.pop()].tolist()
            for a, b in zip(face, face[1:] + face[:1], strict=True):
                for other in sides[min(a, b), max(a, b)]:
                    if not seen[other]:
                        seen[other] = True
                        waiting.append(other)
                        if _runs(faces[other].tolist(), a, b):
                            faces[other] = faces[other][::-1]
    return Mesh(mesh.vertices, faces)


def _runs(face: list[int], a: int, b: int) -> bool:
    """Return whether a face's edge goes from a to b."""
    return (a, b) in zip(face, face[1:] + face[:1], strict=True)


def open_edges(mesh: Mesh) -> np.ndarray:
    """Return the (E, 2) edges that have a face on one side alone, as that face runs along them.

    The faces are turned alike (see `oriented`).
    """
    edges = mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    size = len(mesh.vertices)
    there = edges @ [size, 1]
    return edges[~np.isin(there, edges[:, ::-1] @ [size, 1])]


def openings(mesh: Mesh) -> list[np.ndarray]:
    """Return the vertices of each opening of a mesh whose faces are turned alike, widest first."""
    edges = open_edges(mesh)
    if not len(edges):
        return []
    count = len(mesh.vertices)
    graph = coo_array((np.ones(len(edges)), edges.T), shape=(count, count))
    number = connected_components(graph, directed=False)[1]
    rings = [np.unique(edges[number[edges[:, 0]] == ring]) for ring in np.unique(number[edges])]
    return sorted(rings, key=lambda ring: -_width(mesh.vertices[ring]))


def _width(ring: np.ndarray) -> float:
    return float(np.linalg.norm(ring - ring.mean(0), axis=1).mean())


def volume(mesh: Mesh) -> float:
    """Return what a surface encloses, mL, each opening closed by a fan about its middle.

    By the divergence theorem: the sum of the tetrahedra between the faces and one point.
    """
    mesh = oriented(welded(mesh))
    corners = mesh.vertices[mesh.faces]
    edges = open_edges(mesh)
    for ring in openings(mesh):
        inside = edges[np.isin(edges[:, 0], ring)]
        middle = np.broadcast_to(mesh.vertices[ring].mean(0), (len(inside), 3))
        # Against the way that the faces run, so that the cap is turned as they are.
        cap = np.stack([mesh.vertices[inside[:, 1]], mesh.vertices[inside[:, 0]], middle], 1)
        corners = np.concatenate([corners, cap])
    a, b, c = (corners - mesh.vertices.mean(0)).transpose(1, 0, 2)
    return float(abs(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6e3)


def sampled(mesh: Mesh) -> np.ndarray:
    """Return points all over a surface, (P, 3) mm: vertices, middles of edges and of faces."""
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    return np.concatenate([mesh.vertices, (a + b) / 2, (b + c) / 2, (c + a) / 2, (a + b + c) / 3])
