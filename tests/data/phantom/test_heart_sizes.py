"""The painted heart is measured as a sonographer would, and held against published adult ranges.

Ranges: Lang et al., Recommendations for Cardiac Chamber Quantification by Echocardiography in
Adults, JASE 2015, both sexes together: normal, and up to mildly abnormal.
"""

import pytest
import torch

from racines_data.phantom.heart import _LA, BLOOD, MYOCARDIUM, S, T, heart

STEP = 0.1  # mm
NORMAL = {"LV inside": (37.8, 58.4), "wall": (6.0, 10.0), "LA": (27.0, 40.0), "root": (24.0, 40.0)}
MILD = {"LV inside": (36.0, 63.0), "wall": (6.0, 13.0), "LA": (26.0, 46.0), "root": (22.0, 43.0)}


def run(anatomy, start, way, tissue) -> float:
    """Return the length in mm of a tissue along a ray from a point (mm) that lies in it."""
    along = torch.arange(0, 80, STEP).unsqueeze(1)
    points = torch.tensor(start) + along * torch.tensor(way)
    other = anatomy.paint(points * 1e-3) != tissue
    return float(other.int().argmax()) * STEP


def across(anatomy, centre, way) -> float:
    back = tuple(-x for x in way)
    return run(anatomy, centre, way, BLOOD) + run(anatomy, centre, back, BLOOD)


def measure(seed: int) -> dict[str, float]:
    anatomy = heart(seed)
    size = anatomy.structures[0].centre[2] / heart(0).structures[0].centre[2]
    middle = (0.0, 0.0, 14.0 * size)
    side = run(anatomy, middle, T, BLOOD)
    wall = tuple(m + (side + 0.3) * t for m, t in zip(middle, T, strict=True))
    centre = next(s.centre for s in anatomy.structures if s.name == "aortic root")
    root = tuple(1e3 * x for x in centre)
    return {
        "LV inside": across(anatomy, middle, S),
        "wall": run(anatomy, wall, T, MYOCARDIUM) + 0.3,
        "LA": across(anatomy, tuple(size * x for x in _LA), (0.0, 1.0, 0.0)),
        "root": across(anatomy, root, T),
    }


def outside(sizes, ranges):
    return {k: size for k, size in sizes.items() if not ranges[k][0] <= size <= ranges[k][1]}


def test_the_canonical_heart_is_a_normal_adult_heart():
    assert outside(measure(0), NORMAL) == {}


@pytest.mark.parametrize("seed", [1, 2, 3, 5, 8, 13, 21, 34])
def test_other_hearts_are_normal_to_mildly_abnormal(seed):
    assert outside(measure(seed), MILD) == {}


def test_hearts_differ():
    assert len({round(measure(seed)["wall"], 1) for seed in (1, 2, 3, 5)}) > 2
