"""Worlds without leaflets or chest wall: what a training frame lacks there, and nothing else."""

import pytest
import torch
from torch.nn.functional import max_pool2d

from racines_data.geometry import Pose
from racines_data.patients.labels import LABELS
from racines_data.patients.pool import Pool
from racines_data.patients.population import draw_patient
from tests.models.studies.worlds import LackingPool

PATIENT, A4C = 1, 0


@pytest.fixture(scope="module")
def frames() -> dict[str, torch.Tensor]:
    """Return 8 frames about a patient's A4C over a beat by what the world lacks, and masks."""
    pools = {lacks: LackingPool([draw_patient(PATIENT)], lacks)
             for lacks in ("", "leaflets", "chest")}  # fmt: skip
    pools["pool"] = Pool([PATIENT], beating=True)
    rows = torch.zeros(8, dtype=torch.int64)
    target = pools["pool"].targets(rows)
    shift = torch.linspace(-0.02, 0.02, 8, dtype=torch.float64).unsqueeze(1)
    side = shift * torch.tensor([1.0, 0.5, 0.0], dtype=torch.float64)
    pose = Pose(target.position[:, A4C].double() + side, target.rotation[:, A4C].double())
    phase = torch.stack([torch.arange(8) / 8.0, torch.zeros(8)], 1).double()
    found = {name: pool.render(pose, rows, phase, rows) for name, pool in pools.items()}
    return found | {"mask": pools["pool"].mask(pose, rows, phase)}


def test_a_world_that_lacks_nothing_is_the_world(frames):
    assert torch.equal(frames[""], frames["pool"])


def test_without_leaflets_it_is_they_that_are_missing(frames):
    changed = (frames["leaflets"].int() - frames[""].int()).abs() > 8
    assert 20 < int(changed.sum()) < 0.05 * changed.numel()
    leaves = [place for place, name in enumerate(LABELS) if name.endswith(("leaflet", "cusp"))]
    near = torch.isin(frames["mask"], torch.tensor(leaves, dtype=torch.uint8))
    near = max_pool2d(near.float().unsqueeze(1), 13, 1, 6)[:, 0] > 0
    assert float((changed & near).sum() / changed.sum()) > 0.8
    dark, bright = (frames[name][changed].float().mean() for name in ("leaflets", ""))
    assert float(dark) < float(bright)


def test_without_chest_wall_beams_lose_nothing(frames):
    whole, bare = (frames[name].float() for name in ("", "chest"))
    assert float(bare.mean()) > float(whole.mean())
    shade = [float((each[:, 64:112] < 16).float().mean()) for each in (whole, bare)]
    assert shade[1] < shade[0]
