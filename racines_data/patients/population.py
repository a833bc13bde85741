"""Who a patient is: one seed gives body, heart, place in the chest, examination and rhythm.

Body and sex come first and the heart is drawn given them, so that its sizes go together as they do
in people. Normal ranges: Lang et al., Recommendations for Cardiac Chamber Quantification, JASE
2015, mean ± 2 SD, for each sex. Body: NCD-RisC heights, BMI of adults. All draws are uniform hashes
turned by double arithmetic and rounded, so that a patient is the same on every processor.
"""

from dataclasses import replace
from functools import lru_cache
from statistics import NormalDist

import torch

from racines_data.patients.patient import (
    PATHOLOGIES,
    Body,
    Chest,
    Examination,
    Form,
    Motion,
    Patient,
    Place,
    Tissues,
)
from racines_data.patients.splits import split_of
from racines_data.randomness import sample_seeds, uniform

SICK = 0.2  # share of patients with a pathology, each of the five alike
_DRAWS = 128


class _Draw:
    """Numbers of one patient, in order; rounded, so that all processors agree on them."""

    def __init__(self, seed: int, stream: int = 501):
        drawn = uniform(sample_seeds(torch.tensor([seed]), 1), _DRAWS, stream)
        self._numbers = iter(drawn[0].tolist())

    def between(self, low: float, high: float) -> float:
        return round(low + (high - low) * next(self._numbers), 6)

    def normal(self, mean: float, deviation: float) -> float:
        """Draw from a normal distribution cut off at ± 2 SD."""
        bell = NormalDist()
        share = bell.cdf(-2.0) + (bell.cdf(2.0) - bell.cdf(-2.0)) * next(self._numbers)
        return round(mean + deviation * bell.inv_cdf(share), 6)

    def happens(self, share: float) -> bool:
        return next(self._numbers) < share


@lru_cache(maxsize=4096)
def draw_patient(seed: int) -> Patient:
    """Return the patient of a seed.

    Raises:
        RacinesError: a seed of no split.
    """
    split_of(seed)
    draw, late = _Draw(seed), _Draw(seed, 503)  # late: what came to be drawn after the rest
    sick, which = draw.happens(SICK), 1 + int(draw.between(0.0, 4.999999))
    kind = PATHOLOGIES[which if sick else 0]
    body = _body(draw)
    return Patient(
        seed=seed,
        pathology=kind,
        body=body,
        form=_form(draw, body, kind),
        place=_place(draw),
        chest=_chest(draw, late, body),
        tissues=_tissues(draw),
        examination=_examination(draw, late),
        motion=_motion(draw, kind),
    )


def lie_anew(patient: Patient, other: Patient) -> Patient:
    """Return a patient who lies, is examined and moves as another one does.

    Form and tissues stay, and so do the baked voxels: any number of these costs no baking.
    """
    chest = replace(other.chest, fat=patient.chest.fat)
    return replace(
        patient, place=other.place, chest=chest, examination=other.examination, motion=other.motion
    )


def _body(draw: _Draw) -> Body:
    female = draw.happens(0.5)
    height = draw.normal(1.64, 0.068) if female else draw.normal(1.77, 0.073)
    weight = round(draw.normal(25.5, 3.8) * height * height, 3)
    return Body(female, height, weight, round((height * 100.0 * weight / 3600.0) ** 0.5, 6))


_NORMS = {  # women's mean and SD, men's; mm; Lang et al. 2015, tables 2-4, 7-9 and 14
    "ventricle": (45.0, 3.6, 50.2, 4.1),
    "length": (77.0, 4.5, 85.0, 5.0),  # of the inner long axis at end diastole, apical views
    "wall": (8.0, 0.9, 8.9, 1.0),
    "left_atrium": (33.5, 2.6, 36.0, 2.6),
    "right": (31.5, 3.2, 34.5, 3.2),
    "right_atrium": (35.0, 3.0, 38.0, 3.2),
    "root": (30.0, 2.6, 33.5, 2.8),
    "outflow": (21.5, 2.0, 23.0, 2.2),
}
_WITH_BODY, _TOGETHER = 0.50, 0.35
"""Correlation of a size with body surface, and of sizes with each other beyond that."""


def _form(draw: _Draw, body: Body, kind: str) -> Form:
    common = draw.normal(0.0, 1.0)
    usual = 1.71 if body.female else 1.93
    bulk = max(-2.0, min(2.0, (body.surface - usual) / 0.17))
    own = (1.0 - _WITH_BODY**2 - _TOGETHER**2) ** 0.5
    size: dict[str, float] = {}
    for name, (*woman, mean, deviation) in _NORMS.items():
        mean, deviation = woman if body.female else (mean, deviation)
        z = _WITH_BODY * bulk + _TOGETHER * common + own * draw.normal(0.0, 1.0)
        size[name] = mean + deviation * max(-2.0, min(2.0, z))
    size["septum"] = size["wall"] * draw.between(0.97, 1.15)
    strength = draw.between(0.0, 1.0)
    for name, (low, high) in _CHANGES.get(kind, {}).items():
        size[name] = min(size[name] * (low + (high - low) * strength), _MOST.get(name, 1e3))
    if kind == "hypertrophied" and draw.happens(0.5):
        size["septum"] *= 1.3  # asymmetric
    shape = {
        "oval": draw.between(0.84, 0.97),
        "oval_turn": draw.between(0.0, 3.141593),
        "waviness": draw.between(0.006, 0.022),
        "right_length": draw.between(0.93, 1.06),
        "papillary": draw.between(0.8, 1.25),
    }
    return Form(**{name: round(value, 4) for name, value in (size | shape).items()})


_MOST = {
    "ventricle": 72.0,
    "length": 96.0,
    "right": 52.0,
    "outflow": 28.0,
    "right_atrium": 52.0,
    "left_atrium": 50.0,
}
"""How far a pathology goes, mm."""
_CHANGES: dict[str, dict[str, tuple[float, float]]] = {
    "dilated": {"ventricle": (1.20, 1.38), "length": (1.06, 1.12), "wall": (0.82, 0.95),
                "left_atrium": (1.05, 1.22), "septum": (0.82, 0.95)},
    "hypertrophied": {"ventricle": (0.84, 0.95), "wall": (1.5, 1.9), "septum": (1.5, 1.9),
                      "left_atrium": (1.05, 1.25)},
    "small": {"ventricle": (0.80, 0.88), "length": (0.84, 0.92), "right": (0.84, 0.92),
              "left_atrium": (0.82, 0.92), "right_atrium": (0.82, 0.92), "wall": (0.9, 1.0),
              "root": (0.86, 0.94), "outflow": (0.88, 0.96)},
    "atria": {"left_atrium": (1.22, 1.40), "right_atrium": (1.18, 1.34)},
    "right": {"right": (1.30, 1.50), "right_atrium": (1.12, 1.28), "outflow": (1.15, 1.35),
              "ventricle": (0.88, 0.97)},
}  # fmt: skip


def _place(draw: _Draw) -> Place:
    return Place(
        x=draw.between(-0.030, 0.030),
        y=draw.between(-0.030, 0.030),
        clearance=draw.between(0.002, 0.022),
        turn=draw.between(-0.436332, 0.436332),
        tilt=draw.between(0.0, 0.209440),
        tilt_way=draw.between(0.0, 6.283185),
    )


def _chest(draw: _Draw, late: _Draw, body: Body) -> Chest:
    stout = (body.weight / body.height**2 - 25.5) / 3.8
    return Chest(
        thickness=round(max(0.009, 0.0140 + 0.0023 * stout + draw.between(-0.002, 0.002)), 6),
        fat=draw.between(0.25, 0.5),
        rib_spacing=draw.between(0.026, 0.031),
        rib_width=draw.between(0.008, 0.011),
        rib_loss=draw.between(5.0, 10.0),
        lung_loss=draw.between(8.0, 14.0),
        notch=draw.between(0.036, 0.046),
        slope=draw.between(-0.12, 0.12),
        cover=late.between(0.8, 3.2),
    )


def _tissues(draw: _Draw) -> Tissues:
    return Tissues(
        surroundings=draw.between(-8.0, 4.0),
        unevenness=draw.between(2.5, 5.0),
        grain=draw.between(1.0, 3.0),
        layers=draw.between(0.15, 0.7),
        liver=draw.between(-9.0, -3.0),
        blood=draw.between(-37.0, -29.0),
        patchiness=draw.between(2.5, 5.0),
        valves=draw.between(-1.0, 5.0),
    )


def _examination(draw: _Draw, late: _Draw) -> Examination:
    return Examination(
        half_angle=draw.between(0.646, 0.662),
        margin=draw.between(0.0, 0.16),
        gain=draw.between(-16.0, -6.0),
        dynamic_range=draw.between(55.0, 73.0),
        gray_map=draw.between(1.5, 2.3),
        noise=draw.between(-58.0, -45.0),
        reverberation=draw.between(-28.0, -18.0),
        haze=draw.between(-29.0, -16.0),
        near_gain=draw.between(-8.0, 0.0),
        far_gain=late.between(-4.7, 2.8),
        grain=late.between(4.5, 9.0),
    )


_EMPTYING = {
    "dilated": (0.20, 0.46), "hypertrophied": (0.60, 0.755), "right": (0.50, 0.69),
    "atria": (0.45, 0.68), "small": (0.56, 0.69),
}  # fmt: skip


def _motion(draw: _Draw, kind: str) -> Motion:
    emptying = draw.normal(0.645, 0.032)
    if kind in _EMPTYING:
        emptying = draw.between(*_EMPTYING[kind])
    sick = kind != PATHOLOGIES[0]
    weak = draw.between(0.5, 0.9) if sick and draw.happens(0.35) else 0.0
    fast = 14.0 if sick else 0.0
    flutter = draw.happens(0.4 if kind == "atria" else 0.03)
    early = draw.between(0.05, 0.15) if draw.happens(0.06) else 0.0
    right = draw.between(0.35, 0.52) if kind == "right" else draw.between(0.62, 0.76)
    full = draw.between(13.0, 17.0)
    return Motion(
        emptying=emptying,
        right_emptying=right,
        shortening=round(full * min(1.06, 0.35 + 0.65 * emptying / 0.645), 6),
        atrial=draw.between(0.03, 0.09) * (0.4 if flutter else 1.0),
        kick=0.0 if flutter else draw.between(0.12, 0.30),
        weak=weak,
        weak_at=draw.between(0.0, 6.283185),
        weak_height=draw.between(0.35, 0.8),
        rate=round(draw.normal(68.0 + fast, 9.0), 6),
        variation=draw.between(0.16, 0.26) if flutter else draw.between(0.01, 0.05),
        early=early,
        breath=draw.between(3.0, 5.0),
        sway=draw.between(0.005, 0.015),
    )
