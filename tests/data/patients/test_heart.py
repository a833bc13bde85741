from functools import cache

import pytest
import torch

from racines_data.patients import LABELS, draw_patient
from racines_data.patients.bake import bake, baked, label_box
from racines_data.patients.form import reach, shape_of
from racines_data.patients.labels import BACKGROUND, CODES, LIVER, shown
from racines_data.patients.landmarks import landmarks
from racines_data.patients.volume import (
    BOX,
    BOX_SIZE,
    HEART_BYTES,
    LOW,
    TILE,
    TILE_AT,
    VOXEL,
    centres,
)
from tests.variants import first_of

label_of = cache(lambda seed: label_box(shape_of(draw_patient(seed).form)))
SHOWN = torch.tensor([shown(code, (0, 0, 0)) for code in range(CODES)])
ALL = torch.cartesian_prod(*[torch.arange(BOX)] * 3)
# A dilated, a hypertrophied, a small heart, enlarged atria, a dilated RV, and a healthy one.
SEEDS = (10_008, 10_039, 10_001, 10_012, 10_010, 10_003)


@pytest.mark.parametrize("seed", first_of(SEEDS, 3))
def test_landmarks_lie_in_the_voxels_that_they_name(seed: int) -> None:
    shape = shape_of(draw_patient(seed).form)
    label = SHOWN[label_of(seed).flatten().long()]
    places = centres(ALL)
    for mark in landmarks(shape):
        near = (places - torch.tensor(mark.centre, dtype=torch.float64)).norm(dim=1) < 11.0
        named = torch.zeros_like(near)
        for each in mark.labels:
            named |= near & (label == each)
        assert int(named.sum()) > 150, f"{mark.name} of {seed}: {int(named.sum())} voxels"
        away = places[named].mean(0) - torch.tensor(mark.centre, dtype=torch.float64)
        assert float(away.norm()) < 6.0, f"{mark.name} of {seed} is {float(away.norm()):.1f} mm off"


def test_chambers_are_where_their_landmark_says() -> None:
    for seed in SEEDS:
        shape = shape_of(draw_patient(seed).form)
        label = SHOWN[label_of(seed).flatten().long()]
        for name, limit in (("LA", 5.0), ("RA", 7.0), ("LV", 5.0)):
            mark = next(mark for mark in landmarks(shape) if mark.name == name)
            centroid = centres(ALL[label == LABELS.index(name)]).mean(0)
            away = (centroid - torch.tensor(mark.centre, dtype=torch.float64)).norm()
            assert float(away) < limit, f"{name} of {seed}: {float(away):.1f} mm"


def test_the_border_of_the_box_is_the_tile_to_the_last_byte() -> None:
    """So that no edge is ever seen: where the box ends, its surroundings go on."""
    for seed in (10_008, 10_039):
        voxels = baked(draw_patient(seed))
        assert voxels.numel() * 8 == HEART_BYTES <= 20_000_000
        box = voxels[:BOX_SIZE].view(BOX, BOX, BOX)
        tile = voxels[TILE_AT:][: TILE[0] * TILE[1] * TILE[2]].view(TILE)
        liver = voxels[TILE_AT + tile.numel() :][: tile.numel()].view(TILE)
        label = box.view(torch.uint8).view(BOX, BOX, BOX, 8)[..., 7] & (CODES - 1)
        copied = [each.repeat(*(BOX // size for size in TILE)) for each in (tile, liver)]
        same = (box == copied[0]) | (box == copied[1])
        chest = label == LABELS.index("chest wall")  # the diaphragm's line
        for axis in range(3):
            for face in (0, BOX - 1):
                known = (same | chest).select(axis, face)
                assert bool(known.all()), f"axis {axis}, face {face} of {seed}"
                allowed = torch.tensor([BACKGROUND, LIVER, 13, LABELS.index("chest wall")])
                assert bool(torch.isin(label.select(axis, face), allowed).all())


def test_no_heart_of_the_population_touches_the_border() -> None:
    """Walls and pericardium included; the LV's ellipsoid ends at its annulus."""
    high = [low + BOX * size for low, size in zip(LOW, VOXEL, strict=True)]
    for seed in range(1, 600):
        shape = shape_of(draw_patient(seed).form)
        for axis, way in enumerate(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))):
            back = tuple(-x for x in way)
            near = 1.5 + 3.0 * VOXEL[axis]  # the pericardium, and what is blurred with the heart
            parts = [(shape.left_atrium, 2.4), (shape.right_atrium, 2.4), (shape.right, 3.6)]
            up = [reach(each, way) + wall for each, wall in (*parts, (shape.lv_outer, 0.0))]
            down = [reach(each, back) + wall for each, wall in parts]
            for part in (shape.aorta, shape.outflow, shape.pulmonary, shape.descending, shape.cava):
                ends = [(p[axis], r + 2.5) for p, r in zip(part.path, part.radii, strict=True)]
                up.append(max(p + r for p, r in ends))
                down.append(max(r - p for p, r in ends))
            if axis < 2:
                down.append(reach(shape.lv_outer, back))
            assert max(up) + near < high[axis] and max(down) + near < -LOW[axis], (seed, axis)


def test_a_bake_is_its_patient() -> None:
    one = bake(draw_patient(10_008))
    assert torch.equal(one, baked(draw_patient(10_008)))
    assert not torch.equal(one, baked(draw_patient(10_039)))
