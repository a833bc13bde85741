"""Agents trained and scored with an arm: told and counted, and no free probe's record changes."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_envs.agents.dqn import DQNConfig
from racines_envs.agents.policy import told_settings
from racines_envs.agents.ppo import PPOAgent, PPOConfig
from racines_envs.agents.sac import SACConfig
from racines_envs.agents.training import settings_identity
from racines_envs.evaluation.agent_specs import result_name
from racines_envs.evaluation.patients import PatientsConfig, evaluate_patients
from racines_envs.evaluation.run import (
    EvaluationConfig,
    evaluate,
    record_trace,
    write_evaluation,
)
from racines_envs.evaluation.trainings import Training, _differs
from racines_envs.robots.ur5e import UR5E
from racines_envs.studies.ejection import EjectionConfig, study_ejection
from racines_envs.studies.robustness.run import RobustnessConfig, evaluate_robustness
from racines_leaderboard.board.collect import collect
from racines_leaderboard.cli.command import app
from racines_leaderboard.records.schema import read_json

pytest.importorskip("pytorch_kinematics")
SLOW = replace(UR5E, name="slow", speeds=(1e-3,) * 6)
ARM, FOLDERS = f"{__name__}:SLOW", ("free", "slow")
FEW = EvaluationConfig(starts=4, seeds=(0,), latency=0)
TINY = PPOConfig(
    frames=128, envs=8, update_every=128, minibatch=64, epochs=1, hidden=(8, 8),
    validation_starts=2,
)  # fmt: skip


def scored(robot: str, phantom: Any, folder: Path) -> dict[str, Any]:
    config = replace(FEW, robot=robot)
    write_evaluation(evaluate("random", folder, config, phantom), folder / "random.json", None)
    return read_json(folder / "random.json", "agent-scores")


@pytest.mark.usefixtures("short_episodes")
def test_scores_name_the_arm_and_count_what_it_refused(phantom, tmp_path: Path):
    free = scored("free", phantom, tmp_path)
    assert "robot" not in free["task"] and "arm_hits" not in free["metrics"]
    collect([tmp_path / "random.json"], tmp_path / "results", tmp_path, "tiny")
    carried = scored("ur5e", phantom, tmp_path)
    assert carried["task"] == free["task"] | {"robot": "ur5e"}
    assert set(carried["metrics"]) == {*free["metrics"], "arm_hits"}
    slow = scored(ARM, phantom, tmp_path)
    hits, refused = slow["metrics"]["arm_hits"], slow["metrics"]["violations"]
    assert hits["value"] > 20 and refused["value"] == 0, "nothing else holds it"
    assert slow["by_seed"]["0"]["arm_hits"]["value"] == hits["value"]
    with pytest.raises(RacinesError, match=r"task.robot: .*SLOW; boards are of free probes"):
        collect([tmp_path / "random.json"], tmp_path / "results", tmp_path, "tiny")


def test_on_patients_too(tmp_path: Path):
    config = PatientsConfig(patients=1, starts=2)
    free, slow = (
        evaluate_patients("random", tmp_path, replace(config, robot=robot)).scores
        for robot in ("free", ARM)
    )
    assert slow["task"] == free["task"] | {"robot": ARM}
    assert slow["metrics"]["arm_hits"]["value"] > 0 and "arm_hits" not in free["metrics"]


@pytest.mark.usefixtures("short_episodes")
def test_a_policy_learns_with_an_arm_and_is_another_than_with_none(phantom, tmp_path: Path):
    for name, robot in (("free", "free"), ("slow", ARM)):
        PPOAgent.train(replace(TINY, robot=robot), tmp_path / name, phantom=phantom, progress=False)
    free, slow = (json.loads((tmp_path / each / "config.json").read_text()) for each in FOLDERS)
    assert "robot" not in free["config"]
    assert slow["config"] == free["config"] | {"robot": ARM}
    first, other = ((tmp_path / each / "policy.safetensors").read_bytes() for each in FOLDERS)
    assert first != other, "it learned from steps that were refused"
    assert PPOAgent.load(tmp_path / "slow").config.robot == ARM
    assert "another robot" in _differs(tmp_path / "free", Training(tmp_path / "slow", 0))
    assert not _differs(tmp_path / "free", Training(tmp_path / "free", 0))


@pytest.mark.parametrize("config", [PPOConfig(), SACConfig(), DQNConfig()])
def test_a_free_probe_is_told_as_before_there_were_arms(config: Any):
    """Digests of checkpoints and `config.json` of published policies do not know the setting."""
    assert config.robot == "free"
    assert set(asdict(config)) - set(told_settings(config)) == {"robot", "patients"}
    carried = replace(config, robot="ur5e")
    assert told_settings(carried) == told_settings(config) | {"robot": "ur5e"}
    assert "robot" not in settings_identity("a", config, 0, None)
    assert settings_identity("a", carried, 0, None)["robot"] == "ur5e"


def test_the_command_takes_an_arm_and_names_the_result_by_it(tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["eval", "agent", "planner", "--starts", "1", "--seed", "0", "--set", "robot=ur5e"]
    (tmp_path / "mine").mkdir()
    words += ["--set", "latency=0", "--out", "mine", "--json"]
    done = CliRunner().invoke(app, words, catch_exceptions=False)
    (path,) = (tmp_path / "mine").glob("*.json")
    assert path.name.endswith("-ur5e.json") and done.exit_code == 0
    scores = json.loads(done.stdout)
    assert scores["task"]["robot"] == "ur5e" and "board" not in scores
    assert result_name("ppo", replace(FEW, robot="ur5e"), FEW) == "ppo-ur5e"


def test_studies_and_traces_of_free_probes_refuse_an_arm(phantom, tmp_path: Path):
    out = tmp_path / "out.json"
    with pytest.raises(RacinesError, match="robustness.robot ur5e: the study is of a free probe"):
        evaluate_robustness("planner", tmp_path, RobustnessConfig(robot="ur5e"), out)
    with pytest.raises(RacinesError, match="ejection.robot ur5e: the study is of a free probe"):
        judge: Any = None
        study_ejection("planner", tmp_path, EjectionConfig(robot="ur5e"), judge)
    with pytest.raises(RacinesError, match="a trace is of a free probe, and a ur5e carries"):
        record_trace("random", tmp_path, replace(FEW, robot="ur5e"), out, phantom)
    record_trace("random", tmp_path, FEW, out, phantom)
    with pytest.raises(RacinesError, match="a trace is of a free probe, and a ur5e carries"):
        evaluate(str(out), tmp_path, replace(FEW, robot="ur5e"), phantom)
    assert evaluate(str(out), tmp_path, FEW, phantom).scores["metrics"]
