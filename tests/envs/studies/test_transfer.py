"""The transfer matrix: one truth for all backends, and how alike they rank agents."""

import json

import numpy as np
import pytest
import torch
from scipy import stats

from racines_data.errors import RacinesError
from racines_envs.agents.planner import PlannerAgent
from racines_envs.evaluation import run as evaluation
from racines_envs.evaluation.agent_specs import Run, common_view, find_run, find_runs
from racines_envs.studies.transfer import (
    COMPARED,
    TransferConfig,
    backend_arguments,
    correlate,
    draw_transfer,
    kendall,
    spearman,
    transfer,
    transfer_markdown,
)
from racines_envs.task.actions import IDLE
from racines_envs.worlds.making import make_core

SEER = "tests.envs.studies.test_transfer:Seer"
FEW = TransferConfig(starts=8, seeds=(0,), resamples=100)


class Seer(PlannerAgent):
    """Finds the view as long as it sees anything."""

    name = "seer"
    observation = "image"

    def act(self, observation, seeds):
        dark = observation["image"].flatten(1).amax(1) == 0
        return torch.where(dark, IDLE, super().act(observation, seeds))


class Darkness:
    """A generator that draws nothing."""

    def generate(self, parameters, seed):
        return torch.zeros(len(parameters), 128, 128, dtype=torch.uint8)


def test_correlations_are_scipys_ties_included():
    rng = np.random.default_rng(0)
    for _ in range(20):
        x, y = rng.integers(0, 5, (2, 6))
        if np.ptp(x) and np.ptp(y):
            assert spearman(x, y) == pytest.approx(stats.spearmanr(x, y)[0])
            assert kendall(x, y) == pytest.approx(stats.kendalltau(x, y)[0])
    batch = rng.normal(size=(2, 3, 6))
    assert kendall(*batch).shape == spearman(*batch).shape == (3,)


def test_a_correlation_has_an_interval_over_starts():
    rng = np.random.default_rng(1)
    skill = np.arange(5)[:, None]
    alike = correlate(skill + rng.normal(0, 0.1, (5, 30)), skill + rng.normal(0, 3, (5, 30)), 200)
    for figure in alike.values():
        assert figure["low"] <= figure["value"] <= figure["high"] <= 1 and figure["n"] == 5
    assert alike["spearman"]["value"] > 0.6
    opposite = correlate(skill + np.zeros((5, 4)), -skill + np.zeros((5, 4)), 50)
    assert opposite["kendall"]["value"] == opposite["kendall"]["high"] == -1
    flat = correlate(np.ones((5, 4)), skill + np.zeros((5, 4)), 50)["spearman"]
    assert flat["value"] is None and flat["settings"]["undefined"] == 50


def test_agents_are_run_in_every_backend_and_judged_by_truth(phantom, monkeypatch, tmp_path):
    opened = []

    def make(*names, backend="phantom", generator=None, **more):
        if backend == "generator":
            opened.append(generator)
            backend = Darkness()
        return make_core(*names, backend=backend, **more)

    monkeypatch.setattr(evaluation, "make_core", make)
    runs = [Run("sighted", SEER, tmp_path), *find_runs(["planner", "random"])]
    content = transfer(runs, ["phantom", "generator:night"], FEW, phantom)
    success = {
        (cell["agent"], cell["backend"]): cell["metrics"]["success_true"]["value"]
        for cell in content["cells"]
    }
    assert opened == ["night"], "a backend is opened once for all agents"
    assert success["sighted", "phantom"] == success["planner", "phantom"] == 1
    assert success["sighted", "generator:night"] == 0
    assert success["planner", "generator:night"] == 1
    found = content["correlations"]
    assert [pair["figure"] for pair in found] == list(COMPARED)
    assert found[0]["backends"] == ["phantom", "generator:night"]
    assert found[0]["spearman"]["value"] == pytest.approx(
        0.5
    )  # by hand: ranks 2.5 2.5 1, 1.5 3 1.5
    assert set(content["judged_by"].values()) == {"the phantom's truth"}
    json.dumps(content, allow_nan=False)
    table = transfer_markdown(content)
    assert table.count("\n| sighted | – | 100.0 %") == 1 and "ρ" in table
    draw_transfer(content, tmp_path / "matrix.png")
    assert (tmp_path / "matrix.png").stat().st_size > 5000


def test_backends_by_their_names():
    assert backend_arguments("phantom") == {"backend": "phantom"}
    assert backend_arguments("generator:a:B") == {"backend": "generator", "generator": "a:B"}
    assert backend_arguments("replay:x/y") == {"backend": "replay", "data": "x/y"}
    for wrong in ("ghost", "generator", "replay:", "phantom:x"):
        with pytest.raises(RacinesError, match="replay:<dataset folder>"):
            backend_arguments(wrong)


def test_runs_by_name_folder_and_label(tmp_path):
    content = {"agent": "ppo", "config": {"view": "PL", "backend": "phantom"}, "seed": 4}
    (tmp_path / "config.json").write_text(json.dumps(content))
    run = find_run(f"mine={tmp_path}")
    assert (run.label, run.agent, run.seed) == ("mine", "ppo", 4) and run.folder == tmp_path
    assert find_run(str(tmp_path)).label == tmp_path.name
    assert find_run("random").agent == "random"
    assert common_view([run, find_run("random")]) == "PL" and common_view([]) == "SC"
    with pytest.raises(RacinesError, match="trained for PL, not SC"):
        common_view([run], "SC")
    with pytest.raises(RacinesError, match="LABEL=RUN"):
        find_runs(["random", "random"])
    (tmp_path / "config.json").write_text("{")
    with pytest.raises(RacinesError, match="not readable"):
        find_run(str(tmp_path))
    (tmp_path / "config.json").unlink()
    with pytest.raises(RacinesError, match="not an agent's run folder"):
        find_run(str(tmp_path))


def test_impossible_matrices_are_refused(phantom):
    runs = find_runs(["random"])
    for backends in ([], ["phantom", "phantom"]):
        with pytest.raises(RacinesError, match="name each once"):
            transfer(runs, backends, FEW, phantom)
