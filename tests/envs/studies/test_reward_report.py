"""The reward-hacking report: accounts that the environment agrees with, and what they show."""

import json
from dataclasses import replace

import numpy as np
import pytest

from racines_data.errors import RacinesError
from racines_envs.agents import load_agent
from racines_envs.agents.rollout import rollout
from racines_envs.evaluation.agent_specs import find_runs
from racines_envs.studies.rewards import (
    RewardReportConfig,
    arithmetic,
    draw_returns,
    reward_markdown,
    reward_report,
    run_scored,
    settle,
)
from racines_envs.task.rewards import RewardConfig
from racines_envs.task.starts import evaluation_seeds
from racines_envs.task.tasks import TERMINATIONS, get_task
from racines_envs.worlds.making import make_core
from racines_models.protocol import Judge

LOW = RewardConfig(probability=0.35, grade=3.6)
"""What the stand-in's grader reaches now and then."""


@pytest.mark.parametrize("reward", ["paper", "oracle", "shaped"])
@pytest.mark.parametrize("agent", ["planner", "random"])
def test_the_account_is_the_environments_own(reward, agent, phantom, grader):
    """One run to the last step gives the episodes of every rule, figure by figure."""
    task = replace(get_task("SC"), max_steps=60)
    seeds = evaluation_seeds(6)
    source = "paper" if reward == "paper" else "shaped"
    where = {"observation": "params", "phantom": phantom, "grader": grader, "rewards": LOW}
    whole = make_core(task, 6, reward=source, termination="timeout", **where)
    trace = run_scored(whole, load_agent(agent, ""), seeds)
    for rule in TERMINATIONS:
        core = make_core(task, 6, reward=reward, termination=rule, **where)
        final = rollout(core, load_agent(agent, ""), seeds).final
        settled = settle(trace, reward, core.task.hits_to_end, LOW)
        np.testing.assert_array_equal(settled.steps, final["steps"], err_msg=rule)
        np.testing.assert_array_equal(settled.success, final["success"])
        np.testing.assert_array_equal(settled.graded, final["success_graded"])
        np.testing.assert_allclose(settled.total, final["return"], atol=1e-3)
        np.testing.assert_array_equal(settled.grade, final["grade"] * final["success"])


def test_the_report_shows_what_each_rule_pays(phantom, grader, tmp_path):
    config = RewardReportConfig(starts=5, resamples=50)
    content, episodes = reward_report(find_runs(["planner", "random"]), config, phantom, grader)
    rows = {(r["agent"], r["reward"], r["termination"]): r for r in content["rows"]}
    assert len(rows) == 2 * 3 * 3 == len(episodes)
    earned = [
        rows["planner", "oracle", rule]["metrics"]["return"]["value"] for rule in TERMINATIONS
    ]
    assert earned[0] < 110 < earned[1] < 400 < earned[2], "one hit, three hits, lingering"
    held = rows["planner", "oracle", "k_hits"]
    assert held["parts"]["hits"] >= 3
    terms = ("paid_for_hits", "paid_for_seen", "change_of_probability", "change_of_grade")
    total = sum(held["parts"][name] for name in (*terms, "step_cost"))
    assert total == pytest.approx(held["metrics"]["return"]["value"], abs=1e-3)
    assert 0 < held["parts"]["change_of_grade"] < 10
    assert rows["planner", "oracle", "timeout"]["metrics"]["hovered"]["value"] > 50
    shaped = rows["planner", "shaped", "timeout"]["metrics"]["return"]["value"]
    assert shaped < 50, "a potential cannot be farmed by lingering"
    json.dumps(content, allow_nan=False)
    table = reward_markdown(content)
    assert table.count("\n| planner |") == 9 and "Only 3 hits in a row come near." in table
    assert arithmetic(held, content["numbers"]) in table
    assert arithmetic(rows["planner", "shaped", "k_hits"], content["numbers"]) == ""
    draw_returns(episodes, "SC", tmp_path / "returns.png")
    assert (tmp_path / "returns.png").stat().st_size > 10000


def test_a_high_return_without_the_view_is_counted(phantom):
    """A grader that likes everything is farmed by an agent that goes nowhere near the view."""
    import torch

    class Flatterer(Judge):
        def probabilities_and_grade(self, images):
            return torch.ones(len(images), 6), torch.full((len(images),), 9.0)

    config = RewardReportConfig(starts=4, rewards=("paper",), resamples=50)
    content, _ = reward_report(find_runs(["random"]), config, phantom, Flatterer())
    for row in content["rows"]:
        hacked = row["metrics"]["high_return_without_success"]["value"]
        assert hacked == (row["termination"] != "first_hit"), row["termination"]
        assert row["metrics"]["success_true"]["value"] == 0


def test_impossible_reports_are_refused(phantom, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("racines_models.published.places.CHECKOUT", tmp_path)
    runs = find_runs(["random"])
    fine = RewardReportConfig()
    for wrong in (
        replace(fine, rewards=("gold",)),
        replace(fine, rewards=()),
        replace(fine, terminations=("never",)),
    ):
        with pytest.raises(RacinesError, match="choose of"):
            reward_report(runs, wrong, phantom)
    with pytest.raises(RacinesError, match="racines train grader"):
        reward_report(runs, RewardReportConfig(starts=1), phantom)
