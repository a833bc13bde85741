"""Runs of agents, as the section `agents` of a params file names them."""

import dataclasses
import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_envs.evaluation.agent_specs import find_entry, find_trained, result_name
from racines_envs.evaluation.run import EvaluationConfig
from racines_leaderboard.cli.command import app
from tests.conftest import ROOT
from tests.leaderboard.graphs import sound_policy

PARAMS = """
board: tiny
agents:
  planner: {}
  planner-pl: {agent: planner, view: PL}
  pl: {agent: ppo, view: PL, frames: 256, envs: 16, update_every: 128, minibatch: 64, epochs: 1,
       hidden: [16, 16], validation_starts: 2}
evaluation: {starts: 2, seeds: [0], resamples: 20, latency: 0}
"""
SETTINGS = {
    "agents": {
        "ppo": {"frames": 9},
        "other": {"agent": "ppo", "view": "PL", "hidden": [8]},
        "floor-pl": {"agent": "random", "view": "PL"},
        "dqn": {"agent": "ppo"},
        "bare": None,
    }
}


def test_an_entry_is_a_run_of_its_agent():
    one, two = (find_entry(SETTINGS, name) for name in ("ppo", "other"))
    assert (one.name, one.agent, one.settings, one.view) == ("ppo", "ppo", {"frames": 9}, None)
    assert (two.name, two.agent, two.view) == ("other", "ppo", "PL")
    assert two.settings == {"view": "PL", "hidden": [8]}
    assert two.folder == Path("envs/runs/other")
    assert two.scores == Path("envs/runs/scores/other.json")


def test_a_view_is_for_agents_without_settings_too():
    floor = find_entry(SETTINGS, "floor-pl")
    assert (floor.settings, floor.view) == ({}, "PL")


def test_an_agent_without_an_entry_has_its_own_name_or_the_one_given():
    assert find_entry({}, "ppo").settings == {}
    spec = "racines_envs.agents.dqn:DQNAgent"
    own = find_entry(SETTINGS, spec, "mine")
    assert (own.name, own.agent, own.settings) == ("mine", spec, {}), "agents.dqn is a PPO here"
    assert find_entry(SETTINGS, "dqn").agent == "ppo"
    spec = "racines_envs.agents.ppo:PPOAgent"
    assert find_entry(SETTINGS, spec).settings == {"frames": 9}


def test_runs_on_patients_stand_in_a_section_of_their_own():
    settings = {"agents": {"ppo": {}}, "patient_agents": {"told": {"agent": "planner"}}}
    told = find_entry(settings, "told")
    assert (told.agent, told.where) == ("planner", "patient_agents.told")
    assert find_entry(settings, "ppo").where == "agents.ppo"
    with pytest.raises(RacinesError, match="ppo: stands in agents and in patient_agents.*rename"):
        find_entry({**settings, "patient_agents": {"ppo": {}}}, "ppo")
    with pytest.raises(RacinesError, match=r"patient_agents\.floor\.repeats: 0: give 1 or more"):
        wrong = {"floor": {"agent": "constant-pose", "repeats": 0}}
        find_entry({"patient_agents": wrong}, "floor")


def test_entries_that_are_none_are_refused():
    with pytest.raises(RacinesError, match="unknown agent 'ghost'"):
        find_entry(SETTINGS, "ghost")
    with pytest.raises(RacinesError, match="unknown agent 'bare'"):
        find_entry(SETTINGS, "bare")
    with pytest.raises(RacinesError, match=r"agents\.x: 3 is no mapping"):
        find_entry({"agents": {"x": 3}}, "x")
    with pytest.raises(RacinesError, match=r"agents\.x\.agent: 3"):
        find_entry({"agents": {"x": {"agent": 3}}}, "x")


@pytest.mark.usefixtures("short_episodes")
def test_the_commands_train_and_score_runs_by_name(real_phantom, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "params.yaml").write_text(PARAMS)

    def run(*words):
        done = CliRunner().invoke(app, words, catch_exceptions=False)
        assert done.exit_code == 0, done.output

    for name in ("pl", "planner-pl"):
        run("train", "agent", name, "--json")
        run("eval", "agent", name)
        scores = json.loads((tmp_path / f"envs/runs/scores/{name}.json").read_text())
        assert scores["task"]["view"] == "PL" and scores["board"] == "tiny"
        agent = "ppo" if name == "pl" else "planner"
        assert (scores["agent"], scores["submission"]) == (name, agent)
        assert (tmp_path / f"envs/runs/scores/{name}.png").is_file()
        config = json.loads((tmp_path / f"envs/runs/{name}/config.json").read_text())
        assert config["agent"] == agent
    run("eval", "agent", "planner", "--name", "ceiling", "--view", "SC")
    scores = json.loads((tmp_path / "envs/runs/scores/ceiling.json").read_text())
    assert scores["agent"] == "ceiling" and scores["task"]["view"] == "SC"
    # Into a folder under its usual name; another kind of file is refused before any work.
    (tmp_path / "mine").mkdir()
    run("eval", "agent", "planner", "--view", "SC", "--starts", "1", "--out", "mine")
    assert {path.suffix for path in (tmp_path / "mine").iterdir()} == {".json", ".parquet", ".png"}
    refused = CliRunner().invoke(app, ["eval", "agent", "planner", "--out", "mine/x.txt"])
    assert refused.exit_code == 2 and "end the name with .json" in refused.output


def test_a_result_of_another_view_or_start_set_has_a_name_of_its_own():
    usual = EvaluationConfig(view="SC", starts=5)
    names = {
        "ppo": {},
        "ppo-pl": {"view": "PL"},
        "ppo-replay": {"backend": "replay"},
        "ppo-generator-vae-gan": {"backend": "generator", "generator": "models/weights/vae-gan"},
        "ppo-seed-7": {"seed": 7},
        "ppo-seed-3-4": {"seeds": (3, 4)},
        "ppo-pl-9-starts": {"view": "PL", "starts": 9},
    }
    for name, changes in names.items():
        assert result_name("ppo", dataclasses.replace(usual, **changes), usual) == name


@pytest.mark.usefixtures("short_episodes")
def test_no_result_is_overwritten_in_silence(real_phantom, tmp_path, monkeypatch):
    """A file's policy on two views, another file, another policy under the name of one."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "params.yaml").write_text("evaluation: {starts: 2, seeds: [0], latency: 0}\n")
    for name in ("X.onnx", "y.onnx"):
        sound_policy(tmp_path / name)
    folder = tmp_path / "envs/runs/scores"

    def run(*words):
        done = CliRunner().invoke(app, ["eval", "agent", *words])
        return str(done.exception or done.output)

    for words in (("X.onnx",), ("X.onnx", "--view", "PL"), ("y.onnx",), ("X.onnx", "--seed", "5")):
        assert "written" in run(*words)
    kept = {path.name: path.read_bytes() for path in folder.glob("*.json")}
    assert set(kept) == {"x.json", "x-pl.json", "y.json", "x-seed-5.json"}
    views = {name: json.loads(text)["task"]["view"] for name, text in kept.items()}
    assert views["x.json"] == "SC" and views["x-pl.json"] == "PL"
    assert "written" in run("X.onnx")  # the same, again
    assert "--force to replace it" in run("X.onnx", "--name", "x-pl")
    assert "--force to replace it" in run(
        "X.onnx", "--starts", "1", "--out", str(folder / "y.json")
    )
    sound_policy(tmp_path / "X.onnx", temperature="1.0")
    assert "--force to replace it" in run("X.onnx")
    with monkeypatch.context() as patched:  # refused before any work
        patched.setattr("racines_envs.evaluation.run.evaluate", None)
        assert "result, of y SC phantom" in run("X.onnx", "--out", str(folder / "y.json"))
    assert (folder / "y.json").read_bytes() == kept["y.json"]
    assert "written" in run("X.onnx", "--force")
    (folder / "y.json").write_text("no scores")
    assert "no scores: --force" in run("y.onnx")


def test_a_published_run_is_judged_without_an_entry(tmp_path):
    one = find_trained({}, "servo-memory-plus")
    assert (one.name, one.agent, one.view) == ("servo-memory-plus", "servo-memory", None)
    assert one.settings["looks"] == 2 and one.trained.name == one.name
    mine = find_trained({}, "ppo-image-pl", "mine")
    assert (mine.name, mine.view, mine.trained) == (
        "mine",
        "PL",
        one.trained.with_name("ppo-image-pl"),
    )
    assert find_trained({"agents": {"servo-full": {"agent": "ppo"}}}, "servo-full").agent == "ppo"
    assert find_trained({}, "servo").settings == {}, "an agent's name is the agent, as in training"
    own = tmp_path / "own"
    own.mkdir()
    (own / "config.json").write_text('{"agent": "dqn", "config": {"view": "SC"}}')
    assert find_trained({}, "own", run=own).agent == "dqn"
    for spec, run in (("ghost", None), ("ghost", own), ("../envs/weights/servo-full", None)):
        with pytest.raises(RacinesError, match="unknown agent"):
            find_trained({}, spec, run=run)
    for damaged in ("[]", '{"agent": "ppo", "config": []}', '{"config": {}}'):
        (own / "config.json").write_text(damaged)
        with pytest.raises(RacinesError, match="names no agent"):
            find_trained({}, "own", run=own)
    (own / "config.json").write_text('{"agent": "dq')
    with pytest.raises(RacinesError, match=r"config\.json: not readable as JSON"):
        find_trained({}, "own", run=own)
    with pytest.raises(RacinesError, match="unknown agent 'servo-full'"):
        find_entry({}, "servo-full")


def test_who_was_trained_on_patients_is_judged_on_patients(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "envs/weights/beating/ppo-a4c", "envs/runs/mine")
    words = ("eval", "agent", "mine", "--patients", "1", "--starts", "1", "--out", "mine.json")
    done = CliRunner().invoke(app, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    task = json.loads(Path("mine.json").read_text(encoding="utf-8"))["task"]
    assert (task["definition"]["view"], task["definition"]["tier"]) == ("A4C", "beating")
    asked = CliRunner().invoke(app, ("eval", "agent", "mine", "--tier", "heart", "--patients", "1"))
    assert "--patients need --tier patients" in str(asked.exception or asked.output)
