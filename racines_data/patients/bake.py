"""Bake a patient's heart and its tiles into voxels, and keep what was baked on disk.

Only `HEART_BYTES` a heart: see `volume`. A cached heart is named by its recipe, which is the
world's version and the patient; the cache forgets what was used longest ago when it passes its cap.
"""

import hashlib
import json
import math
import os
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from racines_data.files import cache_folder, write_atomic
from racines_data.patients.form import LIVER, Shape, shape_of
from racines_data.patients.labels import BACKGROUND, BLOOD, MATERIALS, MITRAL, VALVES
from racines_data.patients.paint import paint
from racines_data.patients.patient import Patient
from racines_data.patients.sampling import DIAPHRAGM, DIAPHRAGM_LAYER
from racines_data.patients.tiles import (
    Fields,
    Surroundings,
    chest_tile,
    draw_fields,
    liver_tile,
    pack,
    tile_of,
)
from racines_data.patients.valves import leaflets
from racines_data.patients.volume import BOX, HEART_BYTES, LOW, TILE, VOXEL, centres
from racines_data.phantom.volume import ALONG_SHEET, REFLECTOR_STEP, blur, sheet_normals

VOXELS_VERSION = "0.3.0"
"""Of the world in which voxels last changed; raise it with the world's whenever they do."""
CACHE_BYTES = 4 << 30
"""Cap of the cache on disk, some 215 hearts; RACINES_HEARTS_BYTES in the environment changes it."""
_CHUNK = 1 << 17
_DECIBEL = math.log(10.0) / 20.0
_NEAR = 3  # voxels about the heart that are blurred with it; beyond, the box is the tile


def bake(patient: Patient) -> Tensor:
    """Return the (HEART_SIZE,) int64 voxels of a patient's heart and tiles."""
    shape = shape_of(patient.form)
    return bake_labels(patient, label_box(shape), shape)


def bake_labels(patient: Patient, label: Tensor, shape: Shape) -> Tensor:
    """Return the (HEART_SIZE,) int64 voxels of a heart's (BOX, BOX, BOX) uint8 codes and tiles."""
    fields = draw_fields(patient)
    around = tile_of(patient, fields)
    box = _box(patient, fields, label, around)
    liver, chest = liver_tile(patient, fields), chest_tile(patient, fields)
    _add_liver(box, label, shape, liver, chest)
    return torch.cat([box.flatten(), around.packed, liver, chest])


def label_box(shape: Shape) -> Tensor:
    """Return the (BOX, BOX, BOX) uint8 codes of a heart's box, leaflets included.

    Every second voxel is painted first, then those near a change.
    """
    half = BOX // 2
    index = torch.cartesian_prod(*[torch.arange(half) * 2] * 3)
    coarse = _painted(index, shape).view(half, half, half)
    around = coarse.to(torch.float32).view(1, 1, half, half, half)
    highest = functional.max_pool3d(around, 3, 1, 1)
    changes = (highest != -functional.max_pool3d(-around, 3, 1, 1)).view(half, half, half)
    label, where = _double(coarse), _double(changes).nonzero()
    label[tuple(where.unbind(1))] = _painted(where, shape)
    _add_leaflets(label, shape)
    return label


def _double(grid: Tensor) -> Tensor:
    for axis in range(3):
        grid = grid.repeat_interleave(2, axis)
    return grid


def _painted(index: Tensor, shape: Shape) -> Tensor:
    return torch.cat([paint(centres(part), shape) for part in index.split(_CHUNK)])


def _add_leaflets(label: Tensor, shape: Shape) -> None:
    """Draw the leaflets of all stages into the blood around their valves, in place."""
    blood = torch.tensor([code in BLOOD for code in range(256)])
    root = shape.aorta.path[1]
    for middle, reach in (
        (shape.mitral.centre, shape.mitral.radius + 12.0),
        (shape.tricuspid.centre, shape.tricuspid.radius + 10.0),
        (root, shape.aorta.radii[2] * 2.2),
    ):
        at = [(m - a) / d for m, a, d in zip(middle, LOW, VOXEL, strict=True)]
        index = torch.cartesian_prod(
            *(
                torch.arange(max(0, int(x - reach / d)), min(BOX, int(x + reach / d)))
                for x, d in zip(at, VOXEL, strict=True)
            )
        )
        part = label[tuple(index.unbind(1))]
        inside = blood[part.long()]
        found = torch.zeros_like(part)
        found[inside] = leaflets(centres(index[inside]), shape)
        label[tuple(index.unbind(1))] = torch.where(found > 0, found, part)


def _spread(values: dict[int, float], label: Tensor) -> Tensor:
    """Look up a number for each voxel by its label."""
    table = torch.zeros(256, dtype=torch.float64)
    for code, value in values.items():
        table[code] = value
    for code in range(MITRAL, 64):  # leaflets of all sets are alike
        table[code] = values[VALVES[0]]
    return table[label.long()]


def _box(patient: Patient, fields: Fields, label: Tensor, around: Surroundings) -> Tensor:
    """Return the (BOX, BOX, BOX) int64 voxels of the heart in its surroundings."""
    tissues = patient.tissues
    outside = label == BACKGROUND
    echo = _spread({code: each.echogenicity for code, each in MATERIALS.items()}, label)
    sheets = _spread({code: each.sheets for code, each in MATERIALS.items()}, label) > 0
    tiled = {name: _tiled(getattr(around, name)) for name in ("echo", "impedance", "attenuation")}
    patches = tissues.patchiness * _tiled(fields.slow) * sheets  # dB: walls drop out in places
    echo = echo + patches
    leaf = label >= MITRAL
    echo[leaf] += tissues.valves - MATERIALS[MITRAL].echogenicity
    echo = torch.where(outside, tiled["echo"], echo)
    impedance = _spread({code: each.impedance for code, each in MATERIALS.items()}, label)
    impedance = torch.where(outside, tiled["impedance"], impedance)
    gradient = _gradient(impedance, sheets) * torch.exp(patches.clamp_max(0.0) * _DECIBEL)
    attenuation = _spread({code: each.attenuation for code, each in MATERIALS.items()}, label)
    attenuation = torch.where(outside, tiled["attenuation"], attenuation.to(torch.uint8))
    # Leaflets are not smeared into the blood around: it is blood in other stages.
    smoothed = torch.where(leaf, echo, blur(echo, 0.6))
    smoothed -= 20.0 * math.log10(ALONG_SHEET) * (~sheets & ~outside)
    packed = pack(_tiled(fields.scatter), smoothed, gradient, label, attenuation)
    tile = _tiled(around.packed.view(TILE))
    return torch.where(_widened(~outside), packed.view(label.shape), tile)


def _widened(inside: Tensor) -> Tensor:
    """Return where a voxel within `_NEAR` along each axis is inside."""
    for axis in range(3):
        wide = inside.clone()
        for shift in range(1, _NEAR + 1):
            left, right = (inside.narrow(axis, at, BOX - shift) for at in (shift, 0))
            wide.narrow(axis, 0, BOX - shift).logical_or_(left)
            wide.narrow(axis, shift, BOX - shift).logical_or_(right)
        inside = wide
    return inside


def _add_liver(box: Tensor, label: Tensor, shape: Shape, liver: Tensor, chest: Tensor) -> None:
    """Copy liver and diaphragm from their tiles to where the box has no heart, in place."""
    axes = [centres(torch.arange(BOX).view(-1, 1).expand(-1, 3))[:, i] * n
            for i, n in enumerate(LIVER)]  # fmt: skip
    beyond = axes[0].view(-1, 1, 1) + axes[1].view(-1, 1) + axes[2] - shape.diaphragm
    x, y, z = ((beyond >= 0.0) & (label == BACKGROUND)).nonzero().unbind(1)
    flat = ((x % TILE[0]) * TILE[1] + y % TILE[1]) * TILE[2]
    found, fascia = liver[flat + z % TILE[2]], chest[flat + DIAPHRAGM_LAYER]
    box[x, y, z] = torch.where(beyond[x, y, z] < DIAPHRAGM, fascia, found)


def _tiled(field: Tensor) -> Tensor:
    """Repeat a field of the tile over the box."""
    return field.repeat(*[1] * (field.ndim - 3), *(BOX // size for size in TILE))


def _gradient(impedance: Tensor, sheets: Tensor) -> Tensor:
    """Return the (3, X, Y, Z) impedance from voxel to voxel, with the sheets' normals added.

    Sheets are found in millimetres, since the voxels are no cubes.
    """
    scale = torch.tensor(VOXEL, dtype=torch.float64).view(3, 1, 1, 1)
    steps = torch.stack(torch.gradient(blur(impedance, 0.8))) / REFLECTOR_STEP / scale
    steps = (steps * 1e6).round_() / 1e6  # no sheet takes its side from a rounding's sign
    steps += sheet_normals(steps, sheets)
    return steps * scale


# --- the cache ------------------------------------------------------------------------------------


def recipe(patient: Patient) -> str:
    """Return the name of a baked heart: the hash of the version and of what it is made from."""
    parts = {"version": VOXELS_VERSION, "seed": patient.seed, "form": asdict(patient.form)}
    parts |= {"tissues": asdict(patient.tissues), "fat": patient.chest.fat}
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:24]


def hearts_folder() -> Path:
    """Return where baked hearts are kept."""
    return cache_folder() / "hearts"


def baked(patient: Patient) -> Tensor:
    """Return a patient's voxels from the cache, or bake them and put them there."""
    path = hearts_folder() / f"{recipe(patient)}.voxels"
    if path.is_file() and path.stat().st_size == HEART_BYTES:
        with suppress(OSError):
            os.utime(path)
            return torch.from_numpy(np.fromfile(path, np.int64))
    voxels = bake(patient)
    with suppress(OSError):  # a cache that cannot be written costs time, no more
        write_atomic(path, voxels.numpy().tobytes())
        _forget(path.parent)
    return voxels


def _forget(folder: Path) -> None:
    """Delete the hearts that were used longest ago until the cache fits its cap."""
    cap = int(os.environ.get("RACINES_HEARTS_BYTES", CACHE_BYTES))
    hearts = sorted(folder.glob("*.voxels"), key=lambda path: path.stat().st_mtime, reverse=True)
    for path in hearts[cap // HEART_BYTES :]:
        path.unlink(missing_ok=True)
