"""Unevenness of what is heard: anchored in the heart, smooth, and a matter of the picture alone."""

from collections.abc import Iterator

import pytest
import torch

from racines_data.geometry import Pose
from racines_data.patients import Pool, draw_patient
from racines_data.patients.form import shape_of
from racines_data.patients.patches import WAVES, patches_of, unevenness
from racines_data.patients.settings import Settings
from racines_data.patients.volume import LOW, VOXEL
from tests.data.patients.conftest import SEEDS


def field_at(seed: int, points: torch.Tensor) -> torch.Tensor:
    """Return the dB of a patient at (N, 3) points of the organ, mm."""
    patient = draw_patient(seed)
    waves, steps = (x.unsqueeze(0) for x in patches_of(patient, shape_of(patient.form)))
    place = (points - points.new_tensor(LOW)) / points.new_tensor(VOXEL)
    return unevenness(place.T.view(1, 3, -1, 1), waves, steps).flatten()


def without(pool: Pool, name: str) -> torch.Tensor:
    """Return the pool's waves or steps with all their dB taken away."""
    rows = getattr(pool._settings, name).clone()
    rows[:, 4] = 0.0
    return rows


def test_patches_hang_on_the_patient_and_are_smooth() -> None:
    line = torch.zeros(400, 3, dtype=torch.float64)
    line[:, 2] = torch.linspace(-80.0, 100.0, 400)
    first, again, other = (field_at(seed, line) for seed in (SEEDS[0], SEEDS[0], SEEDS[1]))
    assert torch.equal(first, again) and float((first - other).abs().mean()) > 1.0
    steepest = float(first.diff().abs().max()) / (180.0 / 399)
    assert steepest < 3.0, "dB a mm: between the grid's nodes nothing is lost"


def test_what_lies_behind_the_atria_is_raised_and_what_lies_before_the_apex_is_not() -> None:
    """Over many patients the waves cancel and the steps stay."""
    ends = torch.tensor([[0.0, 0.0, -85.0], [0.0, 0.0, 30.0], [0.0, 0.0, 112.0]]).double()
    behind, inside, before = torch.stack([field_at(s, ends) for s in range(1, 301)]).mean(0)
    assert float(behind - inside) > 1.0 and float(before - inside) < -2.0
    sides = torch.tensor([[-60.0, 0.0, 30.0], [60.0, 0.0, 30.0]]).double()
    right, left = torch.stack([field_at(s, sides) for s in range(1, 301)]).mean(0)
    assert float(left - right) > 3.0


@pytest.fixture
def even(pool: Pool) -> Iterator[Settings]:
    """The same pool without patches and steps, for as long as a test takes."""
    before = pool._settings
    pool._settings = before._replace(waves=without(pool, "waves"), steps=without(pool, "steps"))
    yield before
    pool._settings = before


def test_walls_drop_out_where_the_heart_is_not_where_the_image_is(
    pool: Pool, even: Settings
) -> None:
    """A wave that moves with the heart: with the breath, the dimming goes where the heart goes."""
    row = torch.zeros(1, dtype=torch.int64)
    target = Pose(*(x[:, 0] for x in pool.targets(row)))
    breath = torch.tensor([[0.0, 0.5]], dtype=torch.float64)
    moved = Pose(*(x[:, 0] for x in pool.targets(row, breath)))
    seen = []
    for waves in (pool._settings.waves, even.waves):
        pool._settings = pool._settings._replace(waves=waves)
        seen.append([pool.render(target, row).float(), pool.render(moved, row, breath).float(),
                     pool.render(target, row, breath).float()])  # fmt: skip
    still, along, aside = (b - a for a, b in zip(*seen, strict=True))
    sector = (seen[0][0] > 0) & (seen[0][1] > 0)
    assert float(still[sector].abs().mean()) > 3.0, "patches are seen"

    def alike(other: torch.Tensor) -> float:
        pair = torch.stack([still[sector], other[sector]])
        return float(torch.corrcoef(pair)[0, 1])

    assert alike(along) > 0.8 and alike(along) > alike(aside) + 0.05


def test_the_truth_does_not_ask_for_patches(pool: Pool, even: Settings) -> None:
    rows = torch.arange(3)
    pose = Pose(*(x[:, 0] for x in pool.targets(rows)))
    flat, mask = pool.judge(pose, rows), pool.mask(pose, rows)
    pool._settings = even
    for one, other in zip(pool.judge(pose, rows), flat, strict=True):
        assert torch.equal(one, other)
    assert torch.equal(pool.mask(pose, rows), mask)
    assert pool._settings.waves.shape == (3, 5, WAVES)
