"""What a servo does where it has arrived: it looks on from about there, and weighs what it saw."""

import torch

from racines_data.geometry import geodesic
from racines_envs.agents.servo import mind
from racines_envs.agents.servo.belief import Belief
from racines_envs.task.tasks import get_task
from racines_envs.task.tiers import middles


def test_waypoints_are_spread_evenly_about_the_view():
    offsets, reach = mind.waypoints(), torch.tensor(mind.REACH)
    assert bool((offsets[0] == 0.0).all()) and bool((offsets.abs() <= reach).all())
    spread = offsets[1:, reach > 0] / reach[reach > 0]
    assert float(spread.mean(0).abs().max()) < 0.25
    apart = (spread[:, None] - spread[None]).norm(dim=-1) + 9.0 * torch.eye(len(spread))
    assert float(apart.min()) > 0.6


def minds() -> tuple[mind.Mind, torch.Tensor]:
    """Return two that believe their views in the middle, and the views."""
    labels = torch.zeros(2, dtype=torch.int64)
    sure = torch.eye(3).expand(2, 3, 3)
    return mind.Mind.new(Belief(middles(labels), sure, sure)), labels


def test_a_row_goes_from_waypoint_to_waypoint_and_home():
    kept, labels = minds()
    offsets, task, centre = mind.waypoints(), get_task("A4C-patients"), kept.centre(labels)
    assert torch.allclose(centre.position, middles(labels).position, atol=1e-6)
    kept.step(torch.tensor([True, False]))
    assert kept.place.tolist() == [1, 0] and kept.steps.tolist() == [1, 1]
    goal, then = (kept.goal(centre, further, offsets, task) for further in (0, 1))
    assert torch.equal(goal.position[0], then.position[1]), "the same waypoint of the same centre"
    away = (goal.position - centre.position).norm(dim=-1) / task.step_translation
    assert torch.allclose(away, torch.tensor([offsets[1, :3].norm().item(), 0.0]), atol=1e-3)
    turn = geodesic(goal.rotation, centre.rotation) / task.step_rotation
    assert torch.allclose(turn[0], offsets[1, 3:].norm(), atol=0.02)
    kept.place = kept.place + mind.WAYPOINTS
    home = kept.goal(centre, 0, offsets, task)
    assert torch.allclose(home.position[0], centre.position[0]), "all waypoints are behind it"
    for _ in range(mind.CHOOSE):
        kept.step(torch.tensor([False, False]))
    kept.search(labels)
    assert bool(kept.windows.chosen.all()), "time is up"
    home = kept.goal(kept.centre(labels), 0, offsets, task)
    assert torch.allclose(home.position, kept.centre(labels).position)


def test_what_showed_the_view_draws_and_episodes_are_kept_apart():
    kept, labels = minds()
    ones, about = torch.ones(2, dtype=torch.bool), middles(labels)
    kept.place = kept.place + 1
    for x, worth in ((0.004, 1.0), (-0.004, 0.2)):
        there = about._replace(position=about.position + torch.tensor([x, 0.0, 0.0]))
        kept.learn(kept.belief, there, torch.full((2,), worth), labels, ones)
    found = (kept.centre(labels).position - about.position)[:, 0]
    assert bool((found > 0.0015).all()) and bool((found < 0.002).all()), "half read, half seen"
    kept.learn(kept.belief, about, torch.ones(2), labels, torch.tensor([True, False]))
    assert kept.place.tolist() == [1, 0] and float(kept.seen[1].abs().sum()) == 0.0
