"""What a servo does where it has arrived and sees little."""

import torch

from racines_data.geometry import Pose
from racines_envs.agents.servo.belief import reading
from racines_envs.agents.servo.mind import SIDE, WALK, Mind
from racines_envs.task.tiers import middles

LABELS = torch.tensor([0, 3])


def minds() -> tuple[Mind, Pose]:
    about = middles(LABELS)
    pose = Pose(about.position + torch.tensor([[0.02, 0.01, 0.001]]), about.rotation)
    read = reading(pose, torch.zeros(2, 6), torch.full((2, 6), 0.01))
    return Mind.new(read, 2, torch.device("cpu")), pose


def test_it_walks_across_the_middle_then_at_a_right_angle():
    mind, pose = minds()
    about = middles(LABELS)
    mind.depart(torch.tensor([True, False]), pose, LABELS)
    assert mind.walk.tolist() == [WALK, 0] and mind.legs.tolist() == [1, 0]
    way = (mind.goal.position - about.position)[0]
    assert torch.allclose(way, SIDE * torch.tensor([-0.02, -0.01, 0.0]), atol=1e-6)
    assert torch.equal(mind.goal.position[1], pose.position[1]), "who stays has no new goal"
    mind.depart(torch.tensor([True, False]), pose, LABELS)
    way = (mind.goal.position - about.position)[0]
    assert torch.allclose(way, SIDE * torch.tensor([-0.01, 0.02, 0.0]), atol=1e-6)


def test_a_walk_ends_where_it_leads_or_after_its_steps():
    mind, pose = minds()
    mind.depart(torch.tensor([True, True]), pose, LABELS)
    mind.step(torch.tensor([False, True]))
    assert mind.walk.tolist() == [WALK - 1, 0] and mind.steps.tolist() == [1, 1]
    for _ in range(WALK):
        mind.step(torch.tensor([False, False]))
    assert mind.walk.tolist() == [0, 0]
    mind.forget(torch.tensor([True, False]))
    assert mind.steps.tolist() == [0, WALK + 1] and mind.legs.tolist() == [0, 1]
