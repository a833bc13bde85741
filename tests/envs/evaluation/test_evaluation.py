"""Evaluation: the figures by hand, the scores file, the picture, the commands."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_envs.agents.hill_climber import HillClimberAgent
from racines_envs.agents.random import RandomAgent
from racines_envs.agents.rollout import Episodes
from racines_envs.evaluation.measures import episode_values, measure
from racines_envs.evaluation.run import EvaluationConfig, evaluate, write_evaluation
from racines_envs.task.starts import evaluation_seeds
from racines_models import statistics

FEW = EvaluationConfig(starts=20, seed=0, resamples=200, latency=0)


def test_wilsons_interval_is_the_papers():
    """369 and 350 of 400: 92.3 % (89.2-94.5) and 87.5 % (83.9-90.4), as the paper's are."""
    for hits, expected in ((369, (0.9225, 0.892, 0.945)), (350, (0.875, 0.839, 0.904))):
        figure = statistics.wilson(np.arange(400) < hits)
        values = [figure[key] for key in ("value", "low", "high")]
        assert values == pytest.approx(expected, abs=6e-4) and figure["n"] == 400


def test_the_figures_by_hand():
    final = {
        "success": np.array([True, True, False, False]),
        "success_graded": np.array([True, False, False, False]),
        "steps": np.array([10, 40, 200, 200]),
        "grade": np.array([8.0, 4.0, 0.0, 0.0]),
        "return": np.array([150.0, 20.0, 90.0, -20.0]),
        "peak_force": np.array([12.0, 14.0, 16.0, 18.0]),
        "mean_force": np.array([10.0, 10.0, 10.0, 10.0]),
        "workspace_hits": np.array([0, 1, 2, 0]),
        "force_hits": np.array([0, 0, 1, 0]),
        "position_error": np.array([0.001, 0.002, 0.05, 0.05]),
        "rotation_error": np.array([0.0, 0.0, 0.0, np.pi]),
    }
    paths = np.zeros((2, 4, 3))
    episodes = Episodes(final, paths, paths[..., 0], torch.zeros(4, 12), torch.zeros(4))
    figures, _ = measure(episode_values([episodes], np.array([12, 20, 20, 20])))
    value = {name: figure["value"] for name, figure in figures.items()}
    assert value["success_true"] == 0.5 and figures["success_true"]["n"] == 4
    assert value["success_graded"] == 0.25
    assert value["steps"] == 25 and figures["steps"]["n"] == 2
    assert value["episode_steps"] == 112.5
    assert value["spl"] == pytest.approx((1.0 + 0.5) / 4)
    assert value["final_grade"] == 3 and value["return"] == 60
    assert value["violations"] == 1 and value["peak_force"] == 15
    assert value["position_error"] == pytest.approx(25.75)
    assert value["rotation_error"] == pytest.approx(45)
    assert value["return_without_success"] == 0.25  # the third: 90 points and no true view


def test_scores_tell_the_agents_apart_and_repeat(phantom, tmp_path):
    planner = evaluate("planner", tmp_path, FEW, phantom)
    chance = evaluate("random", tmp_path, FEW, phantom)
    success = "success_true"
    assert planner.scores["metrics"][success]["low"] > chance.scores["metrics"][success]["high"]
    assert planner.scores["metrics"]["spl"]["value"] == planner.scores["metrics"][success]["value"]
    again = evaluate("random", tmp_path, FEW, phantom)
    assert again.scores["metrics"] == chance.scores["metrics"]


def test_the_start_set_is_the_one_it_says(phantom, tmp_path):
    from racines_envs.worlds.making import make_core

    episodes = evaluate("random", tmp_path, FEW, phantom).episodes
    core = make_core("SC", 20, observation="params", reward="oracle", phantom=phantom)
    core.reset(evaluation_seeds(20))
    np.testing.assert_array_equal(episodes.positions[0], core.state.position.numpy())


def test_three_start_sets_are_pooled_and_told_apart(phantom, tmp_path):
    config = replace(FEW, starts=8, seed=None)
    result = evaluate("random", tmp_path, config, phantom)
    scores, each = result.scores, result.scores["by_seed"]
    assert scores["seeds"] == [0, 1, 2] == scores["task"]["start_set"]["seeds"]
    assert scores["metrics"]["return"]["n"] == 24 and list(each) == ["0", "1", "2"]
    alone = evaluate("random", tmp_path, replace(config, seed=1), phantom).scores["metrics"]
    assert each["1"] == alone, "a set alone gives the figures that it gives among others"
    pooled = np.mean([part["final_grade"]["value"] for part in each.values()])
    assert scores["metrics"]["final_grade"]["value"] == pytest.approx(pooled)
    assert len(np.unique(result.episodes.positions[0], axis=0)) == 24


class FirstPixels:
    """Two numbers an image."""

    size = 2

    def __call__(self, images):
        return images.flatten(1).float()[:, :2]


class Onlooker(RandomAgent):
    """Looks through an encoder, as a policy with a frozen one does."""

    name = "onlooker"
    observation = "image"

    def __init__(self):
        self.encoder = FirstPixels()

    def act(self, observation, seeds):
        assert observation["features"].shape == (len(seeds), 2)
        return super().act(observation, seeds)


def test_an_agents_encoder_looks_once_at_each_image(phantom, tmp_path):
    config = replace(FEW, starts=3, latency=50)
    onlooker = f"{__name__}:Onlooker"
    scores = evaluate(onlooker, tmp_path, config, phantom).scores
    assert scores["task"]["observation"] == "image" and scores["agent"] == "onlooker"


def test_one_decision_is_timed_where_wanted(phantom, tmp_path):
    config = replace(FEW, starts=2, latency=50)
    figure = evaluate("planner", tmp_path, config, phantom).scores["metrics"]["latency"]
    assert figure["n"] == 50 and figure["unit"] == "ms" and figure["settings"]["paper_ms"] == 22
    assert 0 < figure["low"] <= figure["value"] <= figure["high"] < 1000
    assert "latency" not in evaluate("planner", tmp_path, FEW, phantom).scores["metrics"]


def test_a_grader_judges_the_last_images(phantom, grader, tmp_path):
    scores = evaluate("planner", tmp_path, FEW, phantom, grader).scores
    assert scores["metrics"]["success_grader"]["n"] == 20
    assert scores["extractors"] == {"grader": grader.settings}
    without = evaluate("planner", tmp_path, FEW, phantom).scores
    assert "success_grader" not in without["metrics"] and without["extractors"] == {}


def test_scores_name_the_grader_that_an_agent_goes_by(phantom, grader, tmp_path):
    climber = HillClimberAgent(grader=grader)
    config = replace(FEW, starts=2)
    scores = evaluate("hill-climber", tmp_path, config, phantom, agent=climber).scores
    assert scores["extractors"] == {"guide": grader.settings}


def test_scores_follow_the_leaderboards_schema_and_the_picture_is_drawn(phantom, tmp_path):
    from PIL import Image

    from racines_leaderboard.records.schema import read_json

    result = evaluate("planner", tmp_path, FEW, phantom)
    write_evaluation(result, tmp_path / "planner.json", tmp_path / "planner.png")
    content = read_json(tmp_path / "planner.json", "agent-scores")
    assert content["task"]["start_set"] == {"seeds": [0], "starts": 20}
    assert content["weights"] is None and content["sees"] == "truth"
    picture = np.asarray(Image.open(tmp_path / "planner.png").convert("L"))
    assert picture.shape[0] > 300 and picture.std() > 5


def test_impossible_evaluations_are_refused(phantom, tmp_path):
    with pytest.raises(RacinesError, match="starts"):
        evaluate("random", tmp_path, EvaluationConfig(starts=0), phantom)
    halves: Any = (0.5,)
    for seeds in ((), (1, 1), halves):
        with pytest.raises(RacinesError, match="seeds"):
            evaluate("random", tmp_path, EvaluationConfig(seeds=seeds), phantom)
    with pytest.raises(RacinesError, match="at least 50"):
        evaluate("random", tmp_path, EvaluationConfig(starts=1, latency=3), phantom)
    with pytest.raises(RacinesError, match="unknown view"):
        evaluate("random", tmp_path, EvaluationConfig(view="A5C"), phantom)
    with pytest.raises(RacinesError, match="racines train grader"):
        evaluate("random", tmp_path, EvaluationConfig(grader=str(tmp_path)), phantom)


@pytest.mark.usefixtures("short_episodes")
def test_the_commands_train_and_score(real_phantom, tmp_path, monkeypatch):
    from racines_leaderboard.cli.command import app

    monkeypatch.chdir(tmp_path)
    (tmp_path / "params.yaml").write_text(
        "seed: 3\nagents:\n  ppo: {frames: 512, envs: 16, update_every: 256, minibatch: 128, "
        "validation_starts: 4}\nevaluation: {starts: 5, resamples: 50}\n"
    )
    runner = CliRunner()
    done = runner.invoke(app, ["train", "agent", "ppo", "--json"], catch_exceptions=False)
    assert done.exit_code == 0 and json.loads(done.stdout)["frames"] == 512
    for agent in ("ppo", "planner"):
        done = runner.invoke(app, ["eval", "agent", agent, "--json"], catch_exceptions=False)
        scores = json.loads((tmp_path / f"envs/runs/scores/{agent}.json").read_text())
        assert json.loads(done.stdout) == scores and scores["agent"] == agent
        assert (tmp_path / f"envs/runs/scores/{agent}.png").stat().st_size > 5000
    assert runner.invoke(app, ["eval", "agent", "ppo", "--view", "PL"]).exception is not None
    assert "n" in runner.invoke(app, ["eval", "agent", "planner", "--starts", "3"]).stdout
    assert json.loads((tmp_path / "envs/runs/ppo/config.json").read_text())["seed"] == 3
