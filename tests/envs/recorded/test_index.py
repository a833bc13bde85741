"""The nearest recorded pose, and ways along recorded poses."""

import pytest
import torch

from racines_data.geometry import Pose, euler_to_matrix, geodesic, pose_keys
from racines_data.randomness import normal
from racines_envs.worlds.recorded.index import Nearest, phase_keys
from racines_envs.worlds.recorded.paths import Ways, gaps, usual_reach
from tests.envs.recorded.held import DOWN, corner, line

TURN = 0.07


def some_poses(count: int, seed: int) -> Pose:
    drawn = normal(torch.arange(count) + 1000 * seed, 6)
    return Pose(drawn[:, :3] * 0.02, euler_to_matrix(drawn[:, 3:] * 0.5))


@pytest.mark.parametrize("tree", [True, False])
def test_the_nearest_is_that_of_all_distances(tree):
    recorded, asked = some_poses(300, 0), some_poses(50, 1)
    near = Nearest(pose_keys(recorded, TURN))
    if not tree:
        near._tree = None  # as on an accelerator
    shift = (asked.position[:, None] - recorded.position).norm(dim=-1)
    angle = geodesic(asked.rotation[:, None], recorded.rotation)
    away = (shift.square() + (TURN * 2.0 * (angle / 2.0).sin()).square()).sqrt()
    keys = pose_keys(asked, TURN)
    index, distance = near(keys)
    assert torch.equal(index, away.argmin(1))
    assert torch.allclose(distance, away.amin(1), atol=1e-6)
    several, far = near.several(keys, 5)
    assert torch.equal(several, away.argsort(1)[:, :5])
    assert torch.allclose(far, away.sort(1).values[:, :5], atol=1e-6)
    alone = near(keys[7:8])
    assert torch.equal(alone[0], index[7:8]) and torch.equal(alone[1], distance[7:8])


def test_phases_lie_on_a_circle_half_a_beat_the_weight_apart():
    keys = phase_keys(torch.tensor([0.0, 0.5, 0.98, 0.02], dtype=torch.float64), 0.02)
    assert (keys[0] - keys[1]).norm().item() == pytest.approx(0.02)
    assert (keys[2] - keys[3]).norm() < (keys[2] - keys[1]).norm() / 5


def keys_of(position: torch.Tensor) -> torch.Tensor:
    return pose_keys(Pose(position, DOWN.expand(len(position), 3, 3)), TURN)


def test_gaps_and_the_usual_reach_know_where_trajectories_begin():
    keys, trajectory = keys_of(line(10)), torch.arange(10) // 5
    found = gaps(keys, trajectory)
    assert found[[0, 5]].isinf().all()
    assert torch.allclose(found[[1, 4, 6]], torch.tensor(0.002), atol=1e-6)
    assert usual_reach(keys, trajectory, 0.004) == pytest.approx(0.005, abs=1e-6)
    # Frames all alone in their trajectories: the gap to the nearest other.
    assert usual_reach(keys, torch.arange(10), 0.004) == pytest.approx(0.005, abs=1e-6)
    # One pose, recorded often.
    assert usual_reach(keys[:1].expand(4, -1), torch.arange(4), 0.004) == 0.004


def test_ways_go_round_corners_and_end_where_it_is_cheapest():
    position = corner(20)
    keys = keys_of(position)
    cost = torch.full((len(keys),), torch.inf)
    cost[-1] = 0.0
    ways = Ways(keys, torch.zeros(len(keys), dtype=torch.int64), 0.004, cost)
    assert bool(ways.joined.all())
    ahead = ways.ahead(keys[:1], 0.01, 0.001)
    assert 2 <= int(ahead) <= 5  # along the sweep, though the goal is 38 mm across
    steps, at = 0, torch.tensor([0])
    while int(at) != len(keys) - 1 and steps < 60:
        at, steps = ways.ahead(keys[at], 0.01, 0.001), steps + 1
    assert int(at) == len(keys) - 1 and steps > 5
    cost[10] = 0.5  # near, and dear
    assert int(Ways(keys, torch.zeros(len(keys)), 0.004, cost).ahead(keys[8:9], 0.5, 0.001)) > 10
    cost[10] = 0.0
    assert int(Ways(keys, torch.zeros(len(keys)), 0.004, cost).ahead(keys[8:9], 0.5, 0.001)) == 10


def test_no_way_leads_over_a_gap():
    position = torch.cat([line(10), line(10) + 0.1])
    keys, cost = keys_of(position), torch.full((20,), torch.inf)
    cost[3] = 0.0
    ways = Ways(keys, torch.zeros(20, dtype=torch.int64), 0.004, cost)
    assert ways.joined.tolist() == [True] * 10 + [False] * 10
