"""Where a heart lies cannot be read from pictures without it: no edge and no tile gives it away.

A network reads the placement, its place and turn on the chest, from frames at poses whose sector
holds no heart wherever that lies. On hearts and placements that it was not trained on it may do no
better than their mean, while the same network reads it from frames that show hearts. Ribs and lung
are switched off: they lie about the heart's windows, and rightly tell of them.
"""

from dataclasses import replace

import pytest
import torch
from torch import nn

from racines_data.geometry import Pose, axis_angle_to_matrix, euler_to_matrix, matmul3
from racines_data.patients import Patient, Pool, draw_patient, lie_anew
from racines_data.patients.labels import BACKGROUND, CHEST
from racines_data.patients.placement import REACH
from racines_data.randomness import sample_seeds, uniform
from racines_data.views import MIDDLES

HEARTS, TRAIN, PLACES = 6, 4, 36
POSES, KEPT = 160, 12
SIDE, STEPS, BATCH = 32, 800, 64


def laid(heart: int, place: int) -> Patient:
    """Return a heart as another patient's lies, in a chest without ribs and lung."""
    patient = lie_anew(draw_patient(1 + heart), draw_patient(100 + heart * PLACES + place))
    return replace(patient, chest=replace(patient.chest, rib_loss=0.0, lung_loss=0.0, cover=0.0))


@pytest.fixture(scope="module")
def pool(own_cache: object) -> Pool:
    return Pool([laid(heart, place) for heart in range(HEARTS) for place in range(PLACES)])


def around(place: torch.Tensor, seed: int, lean: float) -> Pose:
    """Return poses with the face on the skin at (N, 3) places, turned and tilted by chance."""
    count = len(place)
    u = uniform(sample_seeds(seed, count), 4, 3).double()
    about = euler_to_matrix(torch.tensor([MIDDLES["A4C"][3:]], dtype=torch.float64))
    tilt = torch.stack([u[:, 0] - 0.5, u[:, 1] - 0.5, u[:, 2] - 0.5], 1) * lean
    return Pose(place, matmul3(about.expand(count, 3, 3), axis_angle_to_matrix(tilt)))


def scattered(pool: Pool, low: list[float], high: list[float], count: int) -> Pose:
    """Return poses spread over a part of the chest, the face on the skin."""
    u = uniform(sample_seeds(7, count), 2, 5).double()
    edges = torch.tensor([low[:2], high[:2]], dtype=torch.float64)
    place = edges[0] + (edges[1] - edges[0]) * u
    down = torch.full((count, 1), pool.surface_height - 0.004, dtype=torch.float64)
    return around(torch.cat([place, down], 1), 11, 0.4)


def each(pool: Pool, poses: Pose) -> tuple[Pose, torch.Tensor]:
    """Return every pose over every patient, patient after patient."""
    rows = torch.arange(len(pool)).repeat_interleave(len(poses.position))
    return Pose(*(part.repeat(len(pool), *[1] * (part.ndim - 1)) for part in poses)), rows


def without_heart(pool: Pool) -> Pose:
    """Return poses whose sector holds no heart and no liver, whoever is scanned."""
    poses = scattered(pool, [*REACH[0]], [*REACH[1]], POSES)
    everyone, rows = each(pool, poses)
    masks = pool.mask(everyone, rows)
    plain = ((masks == BACKGROUND) | (masks == CHEST)).flatten(1).all(1)
    kept = plain.view(len(pool), POSES).all(0).nonzero()[:KEPT, 0]
    assert len(kept) == KEPT, len(kept)
    return Pose(*(part[kept] for part in poses))


def frames(pool: Pool, poses: Pose) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return small images, standardised placements, and whose hearts they are."""
    everyone, rows = each(pool, poses)
    images = pool.render(everyone, rows, None, torch.arange(len(rows)))
    small = nn.functional.avg_pool2d(images.unsqueeze(1).float(), 128 // SIDE) / 128.0 - 1.0
    where = [[p.place.x / 0.02, p.place.y / 0.02, p.place.turn / 0.25] for p in pool.patients]
    return small, torch.tensor(where)[rows], rows // PLACES


def explained(pool: Pool, poses: Pose) -> float:
    """Return the share of the placements' variance that a network explains on other hearts."""
    images, where, heart = frames(pool, poses)
    learned = heart < TRAIN
    where = where - where[learned].mean(0)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        network = nn.Sequential(
            nn.Conv2d(1, 16, 5, 2, 2), nn.BatchNorm2d(16), nn.ReLU(),
            nn.Conv2d(16, 32, 3, 2, 1), nn.BatchNorm2d(32), nn.ReLU(),
            nn.Conv2d(32, 64, 3, 2, 1), nn.BatchNorm2d(64), nn.ReLU(),
            nn.Flatten(), nn.Dropout(0.3), nn.Linear(1024, 3),
        )  # fmt: skip
        optimizer = torch.optim.AdamW(network.parameters(), 2e-3, weight_decay=0.05)
        rows = learned.nonzero()[:, 0]
        for step in range(STEPS):
            batch = rows[torch.randint(len(rows), (BATCH,))]
            for group in optimizer.param_groups:
                group["lr"] = 2e-3 * (1.0 - step / STEPS)
            missed = network(images[batch]) - where[batch]
            missed.square().mean().backward()
            optimizer.step()
            optimizer.zero_grad()
        with torch.no_grad():
            said = network.eval()(images[~learned])
    # Of a patient all frames are one opinion: a network that knows nothing errs by its noise less.
    opinion, true = (x.view(-1, len(poses.position), 3).mean(1) for x in (said, where[~learned]))
    return float(1.0 - (opinion - true).square().mean() / true.square().mean())


@pytest.mark.thorough
def test_where_a_heart_lies_cannot_be_read_without_seeing_it(pool: Pool) -> None:
    x, y = MIDDLES["A4C"][:2]
    seen = explained(pool, scattered(pool, [x - 0.02, y - 0.02], [x + 0.02, y + 0.02], 2 * KEPT))
    unseen = explained(pool, without_heart(pool))
    assert seen > 0.15, (seen, unseen)
    assert unseen < 0.05, (seen, unseen)
