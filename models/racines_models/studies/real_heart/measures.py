"""Measures of a beating heart given as surfaces: biv-me's files, one surface a phase.

    NAME_LV_ENDOCARDIAL_000.obj   NAME_RV_ENDOCARDIAL_000.obj   NAME_EPICARDIAL_000.obj   … 001 …

Vertices of one surface go with the same muscle in all phases. Cavities are closed at their valves;
the long axis runs from the middle of the mitral valve to the apex.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import KDTree

from racines_data.errors import RacinesError
from racines_models.studies.real_heart.meshes import Mesh, openings, read_obj, sampled, volume

SURFACES = ("LV_ENDOCARDIAL", "RV_ENDOCARDIAL", "EPICARDIAL")
NAME = re.compile(rf"(?P<who>.+)_(?P<what>{'|'.join(SURFACES)})_(?P<phase>\d+)\.obj")
BAND = 0.3, 0.7
"""Part of the long axis, from the base, whose wall is measured."""
MIDDLE = 0.45, 0.55
"""Part of it whose width is the diameter."""
UNITS = {
    "lv_edv": "mL",
    "lv_esv": "mL",
    "lv_ef": "%",
    "rv_edv": "mL",
    "rv_esv": "mL",
    "rv_ef": "%",
    "lv_length_ed": "mm",
    "lv_shortening": "mm",
    "lv_diameter_ed": "mm",
    "septum_ed": "mm",
    "wall_ed": "mm",
    "septum_thickening": "%",
    "wall_thickening": "%",
    "muscle_change": "%",
}
"""Measures and their units; a population's table has them under the same names."""


class Phase(NamedTuple):
    """One instant of the beat."""

    lv: float  # mL
    rv: float  # mL
    muscle: float  # mL, of both ventricles
    length: float  # mm, mitral valve to apex
    diameter: float  # mm, inside, half-way
    septum: float  # mm, mean thickness of its middle part
    wall: float  # mm, the same of the LV's free wall


def read_heart(folder: Path) -> list[dict[str, Mesh]]:
    """Return the surfaces of one heart by name, a mapping a phase.

    Raises:
        RacinesError: no such files, several hearts, or a phase that lacks a surface.
    """
    found: dict[int, dict[str, Path]] = {}
    people = set()
    for path in sorted(folder.glob("*.obj")) if folder.is_dir() else ():
        if match := NAME.fullmatch(path.name):
            people.add(match["who"])
            found.setdefault(int(match["phase"]), {})[match["what"]] = path
    if len(people) != 1:
        told = f"surfaces of {len(people)} hearts (NAME_LV_ENDOCARDIAL_000.obj …)"
        raise RacinesError(f"{folder}: {told}; name a folder of one heart")
    for phase, files in found.items():
        if absent := [name for name in SURFACES if name not in files]:
            raise RacinesError(
                f"{folder}: phase {phase:03d} lacks {', '.join(absent)}; get it again"
            )
    return [{name: read_obj(found[p][name]) for name in SURFACES} for p in sorted(found)]


def measure_phases(heart: list[dict[str, Mesh]]) -> list[Phase]:
    """Measure each phase; the apex is the vertex farthest from the mitral valve in the first."""
    first = heart[0]["LV_ENDOCARDIAL"]
    rings = openings(first)
    if not rings:
        raise RacinesError("LV_ENDOCARDIAL: closed; a valve's opening tells where the base is")
    base = first.vertices[rings[0]].mean(0)
    apex = int(np.linalg.norm(first.vertices - base, axis=1).argmax())
    return [_measure(surfaces, rings[0], apex) for surfaces in heart]


def _measure(surfaces: Mapping[str, Mesh], mitral: np.ndarray, apex: int) -> Phase:
    inner, right, outer = (surfaces[name] for name in SURFACES)
    lv, rv, whole = (volume(each) for each in (inner, right, outer))
    base = inner.vertices[mitral].mean(0)
    axis = inner.vertices[apex] - base
    length = float(np.linalg.norm(axis))
    along = (inner.vertices - base) @ axis / length**2
    away = np.linalg.norm(inner.vertices - base - np.outer(along, axis), axis=1)
    band = (along > BAND[0]) & (along < BAND[1])
    middle = (along > MIDDLE[0]) & (along < MIDDLE[1])
    points = inner.vertices[band]
    to_right, to_outer = (KDTree(sampled(each)).query(points)[0] for each in (right, outer))
    septal = to_right < to_outer
    if not septal.any() or septal.all():
        told = "no part of the LV's wall lies between the ventricles, or all of it does"
        raise RacinesError(f"{', '.join(SURFACES)}: {told}; give them in one frame, mm")
    return Phase(
        lv,
        rv,
        whole - lv - rv,
        length,
        2.0 * float(away[middle].mean()),
        float(to_right[septal].mean()),
        float(to_outer[~septal].mean()),
    )


def heart_measures(phases: list[Phase]) -> dict[str, float]:
    """Return the measures in `UNITS`: end diastole is when the LV is fullest."""
    full, empty = max(phases, key=_lv), min(phases, key=_lv)
    right = [each.rv for each in phases]
    muscle = [each.muscle for each in phases]
    return {
        "lv_edv": full.lv,
        "lv_esv": empty.lv,
        "lv_ef": 100.0 * (1.0 - empty.lv / full.lv),
        "rv_edv": max(right),
        "rv_esv": min(right),
        "rv_ef": 100.0 * (1.0 - min(right) / max(right)),
        "lv_length_ed": full.length,
        "lv_shortening": full.length - empty.length,
        "lv_diameter_ed": full.diameter,
        "septum_ed": full.septum,
        "wall_ed": full.wall,
        "septum_thickening": 100.0 * (empty.septum / full.septum - 1.0),
        "wall_thickening": 100.0 * (empty.wall / full.wall - 1.0),
        "muscle_change": 100.0 * (max(muscle) - min(muscle)) / full.muscle,
    }


def _lv(phase: Phase) -> float:
    return phase.lv


def phase_table(phases: list[Phase]) -> list[dict[str, Any]]:
    """Return the phases as JSON has them."""
    return [
        {"phase": i} | {k: round(v, 3) for k, v in p._asdict().items()}
        for i, p in enumerate(phases)
    ]
