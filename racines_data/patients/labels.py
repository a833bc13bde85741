# pyright: strict
"""What a voxel is: chamber, wall or leaflet, and how each of them scatters.

A voxel's last byte holds its label in six bits and its attenuation in two, so that one gather
brings both. Leaflets cannot be moved by an invertible map, since they part and meet: a voxel of a
valve says in which of four stages of opening it is leaflet, and else it is blood.

Acoustic values: Duck, Physical Properties of Tissue (1990); Szabo, Diagnostic Ultrasound Imaging
(2014).
"""

from typing import NamedTuple

LABELS = (
    "background", "LV", "LV myocardium", "LA", "RV", "RV wall", "RA", "atrial wall", "aorta",
    "vessel wall", "pulmonary artery", "papillary muscle", "pericardium", "inferior vena cava",
    "descending aorta", "liver", "chest wall", "mitral leaflet", "tricuspid leaflet",
    "aortic cusp",
)  # fmt: skip
"""Labels of a mask, by their number."""
(
    BACKGROUND,
    LV,
    MYOCARDIUM,
    LA,
    RV,
    RV_WALL,
    RA,
    ATRIAL_WALL,
    AORTA,
    VESSEL_WALL,
    PULMONARY,
    PAPILLARY,
    PERICARDIUM,
    CAVA,
    DESCENDING,
    LIVER,
    CHEST,
    MITRAL,
    TRICUSPID,
    AORTIC,
) = range(20)

CAMUS = {LV: 1, PAPILLARY: 1, MITRAL: 1, MYOCARDIUM: 2, LA: 3}
"""CAMUS's labels of ours, all else 0: papillaries and leaflets lie in the cavity, and since LV and
LA meet in one plane at the annulus, the mitral plane is flat, as cardiologists draw it there."""

BLOOD = (LV, LA, RV, RA, AORTA, PULMONARY, CAVA, DESCENDING)

STAGES = 4
"""Stages of a valve's opening, closed to open."""
VALVES = (MITRAL, TRICUSPID, AORTIC)
BEHIND = {MITRAL: LV, TRICUSPID: RV, AORTIC: AORTA}
"""The blood in which a valve's leaflets move."""
_SETS = 2**STAGES - 1
CODES = 64  # of six bits


def valve_code(valve: int, stages: int) -> int:
    """Return the code of a voxel that is leaflet in a set of stages, given as bits, 1-15."""
    return MITRAL + VALVES.index(valve) * _SETS + stages - 1


def shown(code: int, open_stages: tuple[int, ...]) -> int:
    """Return the label of a code when the valves stand in stages, in the order of `VALVES`."""
    if code < MITRAL:
        return code
    which, stages = divmod(code - MITRAL, _SETS)
    if which >= len(VALVES):
        return BACKGROUND
    valve = VALVES[which]
    return valve if (stages + 1) >> open_stages[which] & 1 else BEHIND[valve]


class Material(NamedTuple):
    """Acoustic properties of a label."""

    echogenicity: float  # dB against myocardium
    attenuation: int  # class: see `ATTENUATIONS`
    impedance: float  # MRayl
    sheets: bool  # whether it scatters less along its surface than across


ATTENUATIONS = 0.15, 0.35
"""Attenuation of class 0 and what each of the classes 1-3 adds, dB/cm/MHz: blood 0.15, soft tissue
0.5, walls of vessels 0.85, pericardium 1.2."""
SOFT = 1

MATERIALS: dict[int, Material] = {
    BACKGROUND: Material(-6.0, SOFT, 1.602, False),
    MYOCARDIUM: Material(0.0, SOFT, 1.687, True),
    RV_WALL: Material(-4.0, SOFT, 1.687, True),
    PAPILLARY: Material(1.0, SOFT, 1.687, True),
    ATRIAL_WALL: Material(-3.0, 2, 1.763, True),
    VESSEL_WALL: Material(0.5, 2, 1.763, True),
    PERICARDIUM: Material(4.0, 3, 1.865, True),
    **{blood: Material(-34.0, 0, 1.657, False) for blood in BLOOD},
    **{valve: Material(4.0, SOFT, 1.720, False) for valve in VALVES},
}
