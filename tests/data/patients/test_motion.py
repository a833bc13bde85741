from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from racines_data.geometry import Pose, rotate
from racines_data.patients import Pool, draw_patient, render
from racines_data.patients.chest import GIVE, breathing, deform, undeform
from racines_data.patients.form import shape_of
from racines_data.patients.heart import make_heart
from racines_data.patients.labels import CAMUS, MYOCARDIUM
from racines_data.patients.measures import PARTS, measure
from racines_data.patients.motion import (
    Dynamics,
    activation,
    dynamics_of,
    from_diastole,
    to_diastole,
    valve_stages,
)
from racines_data.patients.paint import paint
from racines_data.patients.placement import SURFACE
from racines_data.patients.rhythm import Rhythm, phases, rhythm_of
from racines_data.patients.sampling import SPACING, base_nodes
from racines_data.patients.volume import HEART_SIZE, VOXEL, to_voxels
from tests.variants import first_of

SIDES = ((-88.0, 50.0), (-60.0, 68.0), (-68.0, 100.0))
GRID = torch.cartesian_prod(*(torch.linspace(*side, 15, dtype=torch.float64) for side in SIDES))
LEVELS = torch.tensor([0.0, 0.25, 0.5, 0.8, 1.0], dtype=torch.float64)


def dynamics(seed: int) -> Dynamics:
    patient = draw_patient(seed)
    fields = dynamics_of(shape_of(patient.form), patient.motion)
    return Dynamics(*(each.unsqueeze(0).expand(len(LEVELS), *each.shape) for each in fields))


def jacobian(motion: Dynamics, step: float = 1e-4) -> torch.Tensor:
    """Return the (levels, M) determinant of the map from now to end diastole."""
    columns = []
    for axis in torch.eye(3, dtype=torch.float64) * step:
        ahead, back = ((GRID + way).expand(len(LEVELS), -1, -1) for way in (axis, -axis))
        columns.append(to_diastole(ahead, motion, LEVELS) - to_diastole(back, motion, LEVELS))
    return torch.linalg.det(torch.stack(columns, -1) / (2.0 * step))


def test_the_jacobian_is_positive_in_a_hundred_patients() -> None:
    for seed in range(10_000, 10_100):
        least = float(jacobian(dynamics(seed)).min())
        assert least > 0.2, f"{seed}: {least}"


def test_at_end_diastole_nothing_has_moved() -> None:
    motion = dynamics(10_000)
    still = to_diastole(GRID.expand(len(LEVELS), -1, -1), motion, torch.zeros_like(LEVELS))
    assert torch.allclose(still[0], GRID, atol=1e-4)


def test_the_way_back_is_the_inverse() -> None:
    motion = dynamics(10_010)
    points = GRID[(GRID.norm(dim=1) > 12.0)][::7].expand(len(LEVELS), -1, -1)
    there = to_diastole(points, motion, LEVELS)
    assert float((from_diastole(there, motion, LEVELS, 400) - points).abs().max()) < 0.05


# Healthy, dilated with a weak region, hypertrophied, dilated RV.
@pytest.mark.parametrize("seed", first_of([10_000, 10_041, 10_039, 10_010], 2))
def test_walls_keep_their_volume_and_the_ventricle_ejects(seed: int) -> None:
    heart = make_heart(draw_patient(seed), False)
    found = measure(heart)
    wall = torch.tensor(found.volumes["myocardium"])
    assert float((wall / wall[0] - 1.0).abs().max()) < 0.05
    assert 0.15 <= found.ejection_fraction <= 0.75
    if heart.patient.pathology == "healthy":
        assert 0.55 <= found.ejection_fraction <= 0.70
        assert 12.0 <= found.shortening <= 18.0
        assert found.wall[1] > 1.2 * found.wall[0], "the wall thickens"
        # Norm 0.58 with a standard deviation of 0.065 (Lang et al. 2015).
        assert 0.45 <= found.right_ejection_fraction <= 0.71
    traced = {label for label, theirs in CAMUS.items() if theirs == 1}
    assert traced == set(PARTS["lv"]), "volumes and masks trace one cavity"
    atrium = found.volumes["la"]
    assert atrium[-1] > 1.1 * atrium[0], "the atrium fills while the ventricle empties"
    assert found.volumes["rv"][-1] < 0.8 * found.volumes["rv"][0]


@pytest.mark.thorough
def test_walls_keep_their_volume_in_a_hundred_patients() -> None:
    """Counted at points that lie in no rows: rows of a lattice miscount walls along them."""
    shares = torch.quasirandom.SobolEngine(3).draw(1 << 14, dtype=torch.float64)
    for seed in range(10_000, 10_100):
        shape = shape_of(draw_patient(seed).form)
        middle, radii = (
            torch.tensor(each, dtype=torch.float64)
            for each in (shape.lv_outer.centre, shape.lv_outer.radii)
        )
        high = middle + torch.cat([radii[:2].max().expand(2), radii[2:]]) + 2.0
        low = 2.0 * middle - high
        low[2] = -6.0  # the wall ends at the annulus
        points = (low + shares * (high - low)).expand(len(LEVELS), -1, -1)
        label = paint(to_diastole(points, dynamics(seed), LEVELS).flatten(0, 1), shape)
        wall = (label == MYOCARDIUM).view(len(LEVELS), -1).double().mean(1)
        most = float((wall / wall[0] - 1.0).abs().max())
        assert most < 0.05, f"{seed}: {most}"


def test_contraction_and_valves_go_round() -> None:
    phase = torch.linspace(0.0, 0.999, 400, dtype=torch.float64)
    kick = torch.full_like(phase, 0.2)
    act = activation(phase, kick)
    assert float(act[0]) == 0.0 and abs(float(act[-1])) < 1e-3 and float(act.max()) == 1.0
    assert float(act.diff().abs().max()) < 0.05, "no jump"
    stages = valve_stages(phase, kick)
    filling, ejecting = stages // 4, stages % 4
    assert not bool(((filling > 0) & (ejecting > 0)).any()), "never both open"
    assert int(filling.max()) == int(ejecting.max()) == 3
    assert bool((ejecting[act.diff().argmax() - 20] > 0).any())


def test_a_rhythm_has_its_rate_and_never_runs_back() -> None:
    patient = draw_patient(10_000)
    tape = Rhythm(*(each.unsqueeze(0) for each in rhythm_of(patient.motion, patient.seed)))
    time = torch.arange(0.0, 40.0, 0.01, dtype=torch.float64)
    cardiac, breath = phases(tape, torch.zeros(len(time), dtype=torch.int64), time, False).T
    assert bool(((cardiac >= 0) & (cardiac < 1) & (breath >= 0) & (breath < 1)).all())
    beats = int((cardiac.diff() < -0.5).sum())
    assert beats == pytest.approx(patient.motion.rate * 40.0 / 60.0, abs=2.5)
    assert float(cardiac.diff()[cardiac.diff() > -0.5].min()) >= 0.0
    held = phases(tape, torch.zeros(3, dtype=torch.int64), time[:3], True)[:, 1]
    assert bool((held == 0).all())


def test_tissue_gives_under_the_probe() -> None:
    tip = torch.tensor([[480.0, 0.0, 57.0]], dtype=torch.float64)  # 8 mm under the skin
    points = torch.tensor([[[480.0, 0.0, 57.0], [480.0, 0.0, 57.0 - GIVE], [480.0, 90.0, -40.0]]])
    points = points.double()
    lifted = (undeform(points, tip) - points)[0, :, 2]
    assert lifted.tolist() == pytest.approx([8.0, 4.0, 8.0 / 9.67], abs=0.1)
    assert torch.allclose(undeform(deform(points, tip), tip), points, atol=1e-3)


def still(pool: Pool, rows: Tensor, phase: Tensor, tip: Tensor) -> Callable[[Tensor], Tensor]:
    """Return the map from (B, M, 3) of the base frame to end diastole, as every sample goes."""
    settings, chest = pool._settings.rows(rows), pool._chest.rows(rows)
    motion, act = pool._dynamics.rows(rows), pool._act(rows, phase)

    def back(points: Tensor) -> Tensor:
        shifted = undeform(points, tip) - (settings.origin + breathing(chest, phase[:, 1]))[:, None]
        return to_diastole(rotate(settings.axes[:, None], shifted), motion, act)

    return back


@pytest.mark.parametrize("indent", [0.0, 4.0, 11.0])
def test_beat_breath_and_probe_together_fold_nothing(pool: Pool, indent: float) -> None:
    rows = torch.arange(len(pool)).repeat_interleave(4)
    time = torch.rand(len(rows), generator=torch.Generator().manual_seed(5)).double() * 6.0
    phase = pool.phase(rows, time)
    settings = pool._settings.rows(rows)
    tip = pool.targets(rows).position[:, 0].double() * 1e3
    tip[:, 2] = SURFACE * 1e3 - indent
    near = tip.unsqueeze(1) + torch.cartesian_prod(
        *[torch.linspace(-30.0, 30.0, 7, dtype=torch.float64)] * 3
    )
    organ = rotate(settings.axes.transpose(1, 2)[:, None], GRID.expand(len(rows), -1, -1))
    points = torch.cat([near, organ + settings.origin.unsqueeze(1)], 1)
    back = still(pool, rows, phase, tip)
    steps = torch.eye(3, dtype=torch.float64) * 1e-4
    columns = [back(points + step) - back(points - step) for step in steps]
    least = float(torch.linalg.det(torch.stack(columns, -1) / 2e-4).min())
    assert least > 0.15, least


def test_the_beat_turns_the_gradients_of_walls(pool: Pool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A beam meets what a field that moves with the heart rises by along it, from node to node.

    All voxels have one gradient here, so that nothing but the way through them counts.
    """
    gradient, heard = (40, -90, 70), []
    voxel = torch.tensor([0, 0, 0, 0, *gradient, MYOCARDIUM], dtype=torch.int8).view(torch.int64)
    monkeypatch.setitem(pool.__dict__, "_voxels", voxel.expand(len(pool) * HEART_SIZE))
    echoes = render._echoes

    def listen(packed: Tensor, shape: torch.Size, incidence: Tensor, *more: Tensor) -> Tensor:
        heard.append(incidence.double())
        return echoes(packed, shape, incidence, *more)

    monkeypatch.setattr(render, "_echoes", listen)
    rows, views = torch.arange(15) % 3, torch.arange(15) % 5
    phase = torch.tensor([[0.375, 0.25]], dtype=torch.float64).expand(15, 2)  # end systole
    every, each = pool.targets(rows, phase), torch.arange(15)
    pose = Pose(every.position[each, views].double(), every.rotation[each, views].double())
    pool.render(pose, rows, phase)

    settings, axis = pool._settings.rows(rows), torch.tensor(gradient, dtype=torch.float64)
    nodes = base_nodes(pose, pool._grid, settings)[:, :-1]  # the last is beyond the beams
    back = still(pool, rows, phase, pose.position * 1e3)
    field = to_voxels(back(nodes.flatten(1, 2))).matmul(axis).view(nodes.shape[:-1])
    way = SPACING * settings.step.view(-1, 1, 1)
    rise = (field.diff(dim=2) / way)[..., :-1]  # nor are there samples up to the last
    met = heard[0][:, ::SPACING].unflatten(2, (-1, SPACING)).mean(-1)[..., :-1]
    along = rotate(settings.axes[:, None, None], nodes.diff(dim=2)[..., :-1, :] / way[..., None])
    unmoved = (along / along.new_tensor(VOXEL)).matmul(axis)
    assert float((met - rise).abs().max()) < 0.1
    assert float((unmoved - rise).square().mean().sqrt()) > 10.0


def test_the_heart_goes_with_the_breath_and_comes_back(pool: Pool) -> None:
    """Landmarks and nominal poses alike, by the patient's own sway."""
    rows = torch.arange(len(pool))
    full = torch.tensor([[0.0, 0.5]], dtype=torch.float64).expand(len(pool), 2)
    way = pool._marks(rows, full) - pool._marks(rows, torch.zeros_like(full))
    expected = torch.tensor([each.motion.sway * 1e3 for each in pool.patients])
    assert torch.allclose(way.norm(dim=-1), expected[:, None].double(), atol=1e-6)
    assert torch.allclose(pool.targets(rows, full).position * 1e3, (
        pool.targets(rows).position * 1e3 + way[:, :1].float()
    ), atol=1e-3)  # fmt: skip
    ends = torch.tensor([[0.0, 0.0]]).expand(len(pool), 2)
    assert torch.equal(pool.targets(rows, ends).position, pool.targets(rows).position)


def test_landmarks_glide_through_the_beat(pool: Pool) -> None:
    rows = torch.zeros(200, dtype=torch.int64)
    phase = torch.stack([torch.linspace(0.0, 0.35, 200), torch.zeros(200)], 1).double()
    marks = pool._marks(rows, phase)
    assert float((marks[-1] - marks[0]).norm(dim=-1).max()) > 8.0
    assert float(marks.diff(dim=0).norm(dim=-1).max()) < 0.25, "no jump from level to level"


def test_pressing_brings_the_heart_nearer(pool: Pool) -> None:
    """The heart yields by less than the probe comes."""
    rows = torch.zeros(1, dtype=torch.int64)
    pose = pool.targets(rows)
    marks = pool._marks(rows, torch.zeros(1, 2, dtype=torch.float64))
    tips = [pose.position[:, 0].double() * 1e3 + torch.tensor([0.0, 0.0, z]) for z in (0.0, -3.0)]
    near = [float((deform(marks, tip) - tip).norm(dim=-1)[0, 1]) for tip in tips]
    assert 0.2 < near[0] - near[1] < 2.8
