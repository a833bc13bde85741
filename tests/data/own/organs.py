"""Small organs to make phantoms of: a cup of tissue with an open rim, a heart of four phases."""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
import yaml
from numpy.typing import ArrayLike

CUP: dict[str, Any] = {
    "name": "cup",
    "source": "made by a test",
    "licence": "CC0-1.0",
    "parts": {
        "wall": {"mesh": "outer.obj", "tissue": "liver"},
        "fluid": {"mesh": "inner.obj", "tissue": "bile", "cap": ["mouth"]},
    },
    "landmarks": {
        "middle": {"part": "fluid", "radius": 14},
        "mouth": {"rim": "mouth", "radius": 14},
        "side": {"at": [18.0, 0.0, 0.0], "radius": 14},
    },
    "views": {
        "CUP": {
            "focus": "middle",
            "beam": ["mouth", "middle"],
            "right": "side",
            "shows": {"middle": 2, "side": 1},
        },
    },
}
"""A sphere of 25 mm with one of 15 mm in it, which is open above z = 9."""


def opened(
    mesh: trimesh.Trimesh, point: tuple[float, ...], way: tuple[float, ...]
) -> trimesh.Trimesh:
    """Return what lies on one side of a plane, with a flat rim in it."""
    height = (mesh.vertices - point) @ way
    mesh.update_faces((height[mesh.faces] > 0.0).any(1))
    below = height < 0.0
    mesh.vertices[below] -= np.outer(height[below], way)
    mesh.remove_unreferenced_vertices()
    flat = (np.abs((mesh.vertices[mesh.faces] - point) @ way) < 1e-9).all(1)
    mesh.update_faces(~flat)
    mesh.remove_unreferenced_vertices()
    return mesh


def write_cup(folder: Path, ending: str = ".obj", scale: float = 1.0) -> Path:
    """Write the meshes of `CUP` and return their folder."""
    folder.mkdir(parents=True, exist_ok=True)
    outer, inner = trimesh.creation.icosphere(3, 25.0), trimesh.creation.icosphere(3, 15.0)
    inner = opened(inner, (0.0, 0.0, 9.0), (0.0, 0.0, -1.0))
    for name, mesh in (("outer", outer), ("inner", inner)):
        mesh.apply_scale(scale)
        if ending == ".vtk":
            import meshio

            cells: dict[str, ArrayLike] = {"triangle": np.asarray(mesh.faces)}
            meshio.write(folder / f"{name}.vtk", meshio.Mesh(np.asarray(mesh.vertices), cells))
        else:
            mesh.export(folder / f"{name}{ending}")
    return folder


def write_sheet(path: Path, values: dict[str, Any]) -> Path:
    """Write a tissues.yaml."""
    path.write_text(yaml.safe_dump(values, sort_keys=False), encoding="utf-8")
    return path


HEART: dict[str, Any] = {
    "name": "small-heart",
    "source": "made by a test",
    "parts": {
        "LV myocardium": {"mesh": "outer_{phase}.ply", "tissue": "myocardium", "cap": ["base"]},
        "RV": {"mesh": "right_{phase}.ply", "tissue": "blood", "cap": ["tricuspid valve"]},
        "LV": {"mesh": "left_{phase}.ply", "tissue": "blood", "cap": ["mitral valve"]},
        "RV wall": {
            "shell": ["RV"],
            "thickness": 3.0,
            "tissue": "myocardium",
            "synthetic": "only the cavity was outlined",
        },
        "LA": {
            "ellipsoid": {"at": [0.0, 0.0, -20.0], "radii": [19.0, 19.0, 22.0]},
            "over": ["around"],
            "tissue": "blood",
            "synthetic": "no atria were outlined",
        },
        "RA": {
            "ellipsoid": {"at": [-44.0, 0.0, -18.0], "radii": [19.0, 19.0, 24.0]},
            "over": ["around"],
            "tissue": "blood",
            "synthetic": "no atria were outlined",
        },
    },
    "landmarks": {
        "mitral valve": {"rim": "mitral valve"},
        "tricuspid valve": {"rim": "tricuspid valve"},
        "tip": {"at": [0.0, 0.0, 76.0]},
        "LV apex": {"at": [0.0, 0.0, 72.0], "radius": 14},
        "LV": {"at": [0.0, 0.0, 30.0], "radius": 16},
        "septum": {"at": [-27.0, 0.0, 25.0], "radius": 16},
        "LV lateral wall": {"at": [27.0, 0.0, 20.0], "radius": 16},
        "RV": {"part": "RV", "radius": 18},
        "LA": {"part": "LA", "radius": 18},
        "window": {"at": [-16.0, 0.0, 92.0]},
        "middle": {"at": [-9.0, 0.0, 20.0]},
        "floor": {"at": [-9.5, 0.0, 0.0]},
    },
    "views": {
        "A4C": {
            "focus": "middle",
            "beam": ["window", "floor"],
            "right": "LV lateral wall",
            "shows": {"LV": 1.5, "LV apex": 1, "septum": 1, "LV lateral wall": 1, "RV": 1, "LA": 1},
        },
    },
    "heart": {"base": "mitral valve", "apex": "tip", "right": "tricuspid valve"},
}
SQUEEZE = (1.0, 0.85, 0.75, 0.9)
"""How wide the ventricles are in each phase against the first."""


def write_heart(folder: Path) -> Path:
    """Write the surfaces of `HEART`, phase by phase, and return their folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, centre, radii in (
        ("left", (0.0, 0.0, 16.0), (22.5, 22.5, 60.0)),
        ("outer", (0.0, 0.0, 16.0), (31.5, 31.5, 68.0)),
        ("right", (-46.0, 0.0, 20.0), (14.0, 24.0, 46.0)),
    ):
        mesh = trimesh.creation.icosphere(3)
        mesh.apply_scale(radii)
        mesh.apply_translation(centre)
        mesh = opened(mesh, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
        for phase, wide in enumerate(SQUEEZE):
            moved = mesh.copy()
            inner = 1.0 if name == "outer" else wide
            moved.vertices[:, :2] = centre[:2] + (moved.vertices[:, :2] - centre[:2]) * inner
            moved.export(folder / f"{name}_{phase:02d}.ply")
    return folder
