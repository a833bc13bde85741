"""Poses about a heart: the same for the same sight, whosever chest it is and wherever it lies."""

import torch

from racines_data.geometry import Pose, geodesic
from racines_data.patients import Pool
from racines_data.patients.chest import sway_of
from racines_data.store.hearts import Hearts, to_heart

SEEDS = 10000, 10003, 20001


def hearts(pool: Pool, rows: torch.Tensor) -> Hearts:
    lying = [heart.placement for heart in pool.hearts]
    sway = [sway_of(*each) * 1e-3 for each in zip(pool.patients, lying, strict=True)]
    columns = [each.axes for each in lying], [each.origin for each in lying], sway
    return Hearts(*(torch.stack(column)[rows] for column in columns))


def test_a_landmark_of_a_breathing_heart_stays_where_it_is_in_that_heart():
    pool = Pool(SEEDS)
    rows = torch.arange(3).repeat_interleave(4)
    breath = torch.tensor([0.0, 0.3, 0.5, 0.9], dtype=torch.float64).repeat(3)
    phase = torch.stack([torch.zeros_like(breath), breath], 1)
    marks, lying = pool._marks(rows, phase) * 1e-3, hearts(pool, rows)
    for k in range(marks.shape[1]):
        pose = Pose(marks[:, k], torch.eye(3, dtype=torch.float64).expand(12, 3, 3))
        found = to_heart(pose, lying, breath).position * 1e3
        assert torch.allclose(found, pool._tracks[rows, 0, k], atol=1e-9)
        held = to_heart(pose, lying).position * 1e3
        assert float((held - found).norm(dim=1)[breath > 0].min()) > 0.5


def test_lengths_and_angles_stay():
    g = torch.Generator().manual_seed(0)
    pose = Pose(
        torch.rand(2, 3, generator=g, dtype=torch.float64),
        torch.linalg.qr(torch.randn(2, 3, 3, generator=g, dtype=torch.float64)).Q,
    )
    found = to_heart(pose, hearts(Pool([5]), torch.zeros(2, dtype=torch.int64)))
    way, turned = (x.position[1] - x.position[0] for x in (pose, found))
    assert torch.allclose(way.norm(), turned.norm()) and not torch.allclose(way, turned)
    angle, same = (geodesic(x.rotation[:1], x.rotation[1:]) for x in (pose, found))
    assert torch.allclose(angle, same, atol=1e-6)
