import numpy as np
import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import Pose
from racines_data.patients import CAMUS, LABELS, Pool, draw_patient, lie_anew
from racines_data.patients.chest import undeform
from racines_data.patients.heart import make_heart
from racines_data.patients.oracle import look
from racines_data.patients.pool import MEMORY, check_memory
from racines_data.patients.settings import PROBE
from racines_data.patients.volume import HEART_BYTES
from racines_data.views import VIEWS
from tests.data.patients.conftest import SEEDS


def at_targets(pool: Pool, rows: torch.Tensor, views: torch.Tensor) -> Pose:
    every, pick = pool.targets(rows), torch.arange(len(rows))
    return Pose(every.position[pick, views], every.rotation[pick, views])


@pytest.fixture(scope="module")
def batch(pool: Pool) -> tuple[Pose, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Poses, rows, phases and seeds of 21 frames of all patients and views."""
    rows = torch.arange(21) % 3
    phase = torch.stack([torch.arange(21) / 21.0, torch.arange(21) / 30.0], 1).double()
    return at_targets(pool, rows, torch.arange(21) % 5), rows, phase, torch.arange(21) + 5


def test_a_row_is_the_same_in_another_pool_batch_and_order(pool: Pool, batch: tuple) -> None:
    pose, rows, phase, seeds = batch
    images, masks = pool.render(*batch), pool.mask(pose, rows, phase)
    truth = pool.judge(pose, rows, phase)
    other = Pool((10_004, SEEDS[2]), beating=True)
    own = (rows == 2).nonzero().squeeze(1).flip(0)
    part = Pose(*(each[own] for each in pose))
    ones = torch.ones(len(own), dtype=torch.int64)
    assert torch.equal(other.render(part, ones, phase[own], seeds[own]), images[own])
    assert torch.equal(other.mask(part, ones, phase[own]), masks[own])
    for one, all_ in zip(other.judge(part, ones, phase[own]), truth, strict=True):
        assert torch.equal(one, all_[own])
    for i in (0, 20):
        alone = Pose(*(each[i : i + 1] for each in pose))
        row = slice(i, i + 1)
        assert torch.equal(pool.render(alone, rows[row], phase[row], seeds[row]), images[row])
        assert torch.equal(pool.judge(alone, rows[row], phase[row]).grade, truth.grade[row])


def test_every_view_is_shown_over_the_whole_beat(pool: Pool) -> None:
    for row in range(3):
        for view in range(5):
            rows = torch.full((8,), row)
            # Breathed out: a breath can bring a rib before a window, and the probe has to give way.
            phase = torch.stack([torch.arange(8) / 8.0, torch.zeros(8)], 1).double()
            truth = pool.judge(at_targets(pool, rows, torch.full((8,), view)), rows, phase)
            assert bool((truth.view == view).all()), (SEEDS[row], VIEWS[view])
            found = float(truth.membership[:, view].min()), float(truth.view_grade[:, view].min())
            assert found[0] > 0.9 and found[1] > 4.5, (SEEDS[row], VIEWS[view], found)


def test_a_clip_is_judged_as_its_moments_are(pool: Pool, batch: tuple) -> None:
    pose, rows, *_ = batch
    moments = (0.0, 0.3, 0.7)
    clip = pool.judge_beat(pose, rows, moments)
    for row, moment in enumerate(moments):
        phase = torch.tensor([[moment, 0.0]], dtype=torch.float64).expand(len(rows), 2)
        alone = pool.judge(pose, rows, phase)
        for name, own, its in zip(alone._fields, clip, alone, strict=True):
            assert torch.allclose(own[row].double(), its.double(), atol=1e-6), name
    assert float((clip.visibility[0] - clip.visibility[1]).abs().max()) > 0.05


def test_grades_rise_with_scores_from_a_half_on(pool: Pool) -> None:
    rows = torch.zeros(30, dtype=torch.int64)
    target = at_targets(pool, rows, rows)
    aside = torch.linspace(0.0, 0.012, 30).unsqueeze(1) * target.rotation[:, :, 1]
    pose = Pose(target.position + aside, target.rotation)
    score, truth = pool.scores(pose, rows)[:, 0], pool.judge(pose, rows)
    assert float(score[0]) > 0.9 and float(score[-1]) < 0.5
    expected = ((score - 0.5) / 0.45).clamp(0.0, 1.0) * 10.0 * truth.clarity
    assert torch.allclose(truth.view_grade[:, 0].double(), expected.double(), atol=1e-5)


def test_views_of_validation_patients_can_be_shown() -> None:
    for seed in range(10_100, 10_115):
        found = make_heart(draw_patient(seed), False).found
        assert float(found.score.min()) > 0.85, seed
        assert float(found.clarity.min()) > 0.6, seed


def test_blood_is_new_in_every_frame_and_walls_are_not(pool: Pool) -> None:
    rows = torch.zeros(2, dtype=torch.int64)
    pose = at_targets(pool, rows, rows)
    first, second = pool.render(pose, rows, None, torch.tensor([1, 2])).float()
    mask = pool.mask(pose, rows)[0]
    change = (first - second).abs()
    wall, blood = mask == LABELS.index("LV myocardium"), mask == LABELS.index("LV")
    assert float(change[wall].mean()) < 0.25 * float(first[wall].mean())
    assert float(first[blood].mean()) < 0.75 * float(first[wall].mean())


def test_masks_lie_as_images_do(pool: Pool) -> None:
    rows = torch.arange(3)
    pose = at_targets(pool, rows, torch.zeros(3, dtype=torch.int64))
    image, mask = pool.render(pose, rows), pool.mask(pose, rows)
    assert mask.dtype == torch.uint8 and int(mask.max()) < len(LABELS)
    assert bool((mask[image == 0] == 0).float().mean() > 0.95)
    for row in range(3):
        for name in ("LV", "LV myocardium", "LA", "RV", "RA"):
            assert int((mask[row] == LABELS.index(name)).sum()) > 60, name
    # In an apical view the apex is up, the atria are down, and the LV is to the right.
    down, right = np.indices((128, 128))

    def middle(name: str) -> tuple[float, float]:
        there = (mask[0] == LABELS.index(name)).numpy()
        return down[there].mean(), right[there].mean()

    assert middle("LV")[0] < middle("LA")[0] and middle("RV")[1] < middle("LV")[1]
    cavity = {CAMUS[LABELS.index(name)] for name in ("LV", "papillary muscle", "mitral leaflet")}
    assert cavity == {1}, "cardiologists trace the cavity with all that is in it"
    camus = torch.zeros_like(mask)
    for ours, theirs in CAMUS.items():
        camus[mask == ours] = theirs
    lv, la = (np.nonzero((camus[0] == each).numpy())[0] for each in (1, 3))
    assert np.percentile(lv, 95) < np.percentile(la, 10) + 4, "the mitral plane is flat"


def test_what_a_rib_shades_is_not_seen(pool: Pool) -> None:
    """With opaque ribs the oracle loses structures and the picture loses its echoes."""
    rows = torch.zeros(40, dtype=torch.int64)
    target = at_targets(pool, rows, torch.full((40,), 2))
    along = torch.stack([torch.linspace(-0.02, 0.02, 40), torch.zeros(40), torch.zeros(40)], 1)
    pose = Pose(target.position + along, target.rotation)
    before = pool._chest
    free = pool.judge(pose, rows)
    try:
        pool._chest = before._replace(rib_loss=torch.full_like(before.rib_loss, 30.0))
        shaded, images = pool.judge(pose, rows), pool.render(pose, rows)
    finally:
        pool._chest = before
    lost = shaded.visibility - free.visibility
    assert float(lost.max()) <= 0.0 and float(lost.min()) < -0.2
    worst = int((free.clarity - shaded.clarity).argmax())
    clear = pool.render(Pose(*(x[worst : worst + 1] for x in pose)), rows[:1]).float()[0]
    darker = clear - images[worst].float()
    assert float((darker > 15.0).float().mean()) > 0.02, "the shadow is in the picture, too"


def test_what_lies_below_the_picture_is_not_seen(pool: Pool) -> None:
    """At half the depth the picture ends above the atria, and so does what is seen."""
    rows = torch.zeros(1, dtype=torch.int64)
    pose, before = at_targets(pool, rows, rows), pool._settings
    free = pool.judge(pose, rows)
    try:
        pool._settings = before._replace(step=before.step * 0.5)
        shallow, mask = pool.judge(pose, rows), pool.mask(pose, rows)
    finally:
        pool._settings = before
    assert int((mask == LABELS.index("LA")).sum()) == 0 < int((mask == LABELS.index("LV")).sum())
    lost = free.visibility - shallow.visibility
    assert float(free.visibility.max()) > 0.8
    assert float(lost.max()) > 0.8 and float(lost.min()) > -1e-6


def test_the_oracle_knows_that_tissue_gives(pool: Pool) -> None:
    """What the probe pushes before itself is seen as the same structure at the same place is."""
    rows, seen = torch.zeros(1, dtype=torch.int64), []
    target = at_targets(pool, rows, rows + 2)
    settings, chest = pool._settings.rows(rows), pool._chest.rows(rows)
    grid = [torch.linspace(-14.0, 14.0, 5).double()] * 2 + [torch.tensor([-16.0, -30.0]).double()]
    near = torch.cartesian_prod(*grid)  # where they lie from the face, whatever the pressure
    for indent in (0.011, 0.016):  # where all of the face touches
        position = target.position.double().clone()
        position[:, 2] = pool.surface_height - indent
        marks = undeform((position * 1e3 + near).unsqueeze(0), position * 1e3)
        pose = Pose(position, target.rotation.double())
        radii = torch.full((len(near),), 6.0, dtype=torch.float64)
        seen.append(look(pose, marks, radii, settings, chest))
    assert torch.allclose(seen[0].clarity, seen[1].clarity, atol=2e-3)
    assert torch.allclose(seen[0].visibility, seen[1].visibility, atol=2e-3)
    assert float(seen[0].visibility.std()) > 0.1


def test_the_box_is_never_seen(pool: Pool) -> None:
    """A heart baked into a box of another content beyond its own voxels would show; tiles do not.

    What lies in the box but not in the heart is the tile, so a pool whose box is never read outside
    of the heart draws the same picture.
    """
    rows = torch.zeros(5, dtype=torch.int64)
    pose = at_targets(pool, rows, torch.arange(5))
    far = Pose(pose.position + torch.tensor([0.06, 0.05, 0.0]), pose.rotation)
    images = pool.render(far, rows).float()
    mask = pool.mask(far, rows)
    sector = images > 0
    assert float((images[sector] < 2).float().mean()) < 0.02, "no air inside the sector"
    assert int(mask.max()) < len(LABELS)


def test_pools_that_do_not_fit_are_refused_before_baking() -> None:
    with pytest.raises(RacinesError, match=r"101 hearts take 2\.0 GB .* 100 fit"):
        check_memory(101)
    with pytest.raises(RacinesError, match="give at least one seed"):
        Pool([])
    with pytest.raises(RacinesError, match="1 fit"):
        Pool([1, 2], memory=HEART_BYTES)
    with pytest.raises(RacinesError, match="no patient's"):
        Pool([0])
    assert MEMORY // HEART_BYTES == 100


def test_an_empty_batch_is_drawn(pool: Pool) -> None:
    none = torch.zeros(0, dtype=torch.int64)
    pose = Pose(torch.zeros(0, 3), torch.zeros(0, 3, 3))
    assert pool.render(pose, none).shape == pool.mask(pose, none).shape == (0, 128, 128)


def test_forces_and_coupling_know_the_skin_alone(pool: Pool) -> None:
    rows = torch.tensor([0, 1])
    pose = at_targets(pool, rows, torch.zeros(2, dtype=torch.int64))
    same = Pose(pose.position[:1].expand(2, 3), pose.rotation[:1].expand(2, 3, 3))
    force = pool.wrench(same)
    assert torch.equal(force[0], force[1]) and force.shape == (2, 6)
    assert bool(pool.workspace.contains(pose).all())
    assert PROBE.samples == 144


def test_a_heart_that_lies_elsewhere_is_held_once(pool: Pool, batch: tuple) -> None:
    own, other = draw_patient(SEEDS[0]), draw_patient(SEEDS[1])
    moved = lie_anew(own, other)
    two = Pool([own, moved])
    assert two._voxels.nbytes == HEART_BYTES and two.seeds == (SEEDS[0], SEEDS[0])
    assert moved.form == own.form and moved.place == other.place
    rows = torch.tensor([0, 1])
    pose = at_targets(two, rows, torch.zeros(2, dtype=torch.int64))
    images, alone = two.render(pose, rows), Pool([SEEDS[0]])
    first = Pose(*(part[:1] for part in pose))
    assert torch.equal(images[:1], alone.render(first, rows[:1]))
    assert (two.judge(pose, rows).membership[:, 0] > 0.9).all()
    assert (pose.position[0] - pose.position[1]).norm() > 0.005
