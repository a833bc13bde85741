"""The reward's formulae, by hand."""

import dataclasses

import pytest
import torch

from racines_data.errors import RacinesError
from racines_envs.agents.planner import PlannerAgent
from racines_envs.task.core import ScanCore
from racines_envs.task.rewards import REWARDS, Reward, RewardConfig, Score, get_reward, is_hit
from racines_envs.task.tasks import get_task
from racines_envs.worlds.making import make_core

CONFIG = RewardConfig()


def score(p: float, g: float, d: float = 0.0) -> Score:
    return Score(torch.tensor([p]), torch.tensor([g]), torch.tensor([d]))


@pytest.mark.parametrize("name", ["paper", "oracle"])
@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ((0.2, 3.0), (0.5, 4.0), 0.0 + 0.3 + 0.0 - 0.1),  # unsure: the grade does not count
        ((0.5, 3.0), (0.95, 4.0), 20.0 + 0.45 + 1.0 - 0.1),  # the view, drawn badly
        ((0.95, 4.0), (0.9, 5.0), 50.0 - 0.05 + 1.0 - 0.1),  # a hit, exactly at both thresholds
        ((0.95, 8.0), (0.89, 9.0), 0.0 - 0.06 + 0.0 - 0.1),  # lost again
    ],
)
def test_the_papers_formula(name, before, after, expected):
    value = get_reward(name)(score(*before), score(*after), torch.tensor([False]), CONFIG)
    assert value.item() == pytest.approx(expected, abs=1e-5)


def test_shaped_pays_the_potentials_change_and_the_prize_once():
    on = get_reward("shaped")(score(0, 0, 10.0), score(0, 0, 9.0), torch.tensor([False]), CONFIG)
    assert on.item() == pytest.approx(10.0 - 0.99 * 9.0 - 0.1, abs=1e-5)
    end = get_reward("shaped")(score(0, 0, 3.0), score(1, 9, 2.0), torch.tensor([True]), CONFIG)
    assert end.item() == pytest.approx(50.0 + 3.0 - 0.1, abs=1e-5)


def test_no_cycle_of_moves_farms_the_shaped_reward():
    """Discounted, every closed walk pays what standing still pays: the potential telescopes."""

    def walk(distances: list[float]) -> float:
        total = 0.0
        for t, (a, b) in enumerate(zip(distances, distances[1:], strict=False)):
            step = get_reward("shaped")(
                score(0, 0, a), score(0, 0, b), torch.tensor([False]), CONFIG
            )
            total += CONFIG.discount**t * step.item()
        return total

    assert walk([5, 9, 2, 7, 5]) == pytest.approx(walk([5, 5, 5, 5, 5]), abs=1e-4)


@pytest.mark.parametrize("terminates", [True, False])
def test_shaping_adds_what_the_start_decides_and_a_cut_episode_keeps_its_potential(
    phantom, terminates
):
    """Discounted: d(start) where the episode terminates; less the discounted d where it is cut."""
    task = dataclasses.replace(get_task("SC"), max_steps=40 if terminates else 5)
    config = RewardConfig(discount=0.95)
    core = make_core(
        task, 6, observation="params", reward="shaped", rewards=config, phantom=phantom
    )
    agent = PlannerAgent()
    agent.attach(core)
    core.reset(seed=0)
    first, plain, total = core.score.distance, torch.zeros(6), torch.zeros(6)
    cut, ended = (torch.zeros(6, dtype=torch.bool) for _ in range(2))
    for step in range(task.max_steps):
        live = ~core.state.done
        _, reward, terminated, truncated = core.step(agent.act({}, core.decision_seeds()))
        total += 0.95**step * reward
        plain += 0.95**step * (config.hit * terminated + config.step * live)
        ended, cut = ended | terminated, cut | truncated
    assert bool((ended if terminates else cut).all())
    left = 0.0 if terminates else 0.95**task.max_steps * core.score.distance
    assert torch.allclose(total - plain, first - left, atol=1e-3)


def test_the_papers_formula_can_be_farmed():
    """Why the shaped reward stands beside it: lingering below the grade beats the end."""
    linger = get_reward("oracle")(score(0.95, 4), score(0.95, 4), torch.tensor([False]), CONFIG)
    assert linger.item() / (1 - 0.95) > 3 * CONFIG.hit


def test_hits_need_both_thresholds():
    assert [bool(is_hit(score(p, g), CONFIG)) for p, g in ((0.9, 5), (0.89, 9), (0.99, 4.9))] == [
        True,
        False,
        False,
    ]


def test_unknown_rewards_are_refused_with_the_known_ones():
    with pytest.raises(RacinesError, match="oracle, paper, shaped"):
        get_reward("sparse")
    assert set(REWARDS.names()) == {"paper", "oracle", "shaped"}


MINE = Reward("mine", "d - d", lambda a, b, ended, _: a.distance - b.distance, needs_distance=True)


def test_a_reward_of_ones_own_by_module_name_and_as_it_is(phantom):
    named = make_core("SC", 2, reward=f"{__name__}:MINE", observation="params", phantom=phantom)
    given = make_core("SC", 2, reward=MINE, observation="params", phantom=phantom)
    paid = []
    for core in (named, given):
        core.reset(0)
        far = core.score.distance
        paid.append(core.step(torch.tensor([0, 1])).reward)
        assert torch.equal(paid[-1], far - core.score.distance) and bool((far > 0).all())
    assert torch.equal(*paid) and named.reward.name == "mine"


def test_a_reward_that_needs_a_judge_asks_for_one(phantom):
    judged = dataclasses.replace(MINE, needs_judge=True)
    with pytest.raises(RacinesError, match="reward 'mine' needs a trained grader"):
        ScanCore(get_task("SC"), phantom, phantom, reward=judged)
