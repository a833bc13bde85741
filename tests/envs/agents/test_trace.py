"""Traces: the same figures as the agent that made them, and nothing on another ground."""

import json
from dataclasses import replace
from typing import Any, cast

import pytest

from racines_data.errors import RacinesError
from racines_envs.agents import load_agent
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.trace import read_trace
from racines_envs.evaluation.patients import (
    PatientsConfig,
    evaluate_patients,
    record_on_patients,
)
from racines_envs.evaluation.run import EvaluationConfig, evaluate, record_trace
from racines_envs.studies.ejection import EjectionConfig, study_ejection
from racines_envs.studies.robustness.run import RobustnessConfig, evaluate_robustness
from tests.envs.agents.test_onnx_policy import policy
from tests.envs.fakes import FakeGrader, FakePhantom
from tests.variants import crossed

pytestmark = pytest.mark.usefixtures("short_episodes")
FEW = EvaluationConfig(starts=6, seeds=(0, 2), resamples=50, latency=0)


@pytest.fixture
def trace(phantom, tmp_path):
    record_trace("planner", tmp_path, FEW, tmp_path / "t.json", phantom)
    return tmp_path / "t.json"


def figures(name, path, config, phantom, **more):
    scores = evaluate(str(name), path, config, phantom, **more).scores
    return {key: scores[key] for key in ("metrics", "by_seed", "task", "seeds", "phantom")}


@pytest.mark.parametrize(
    ("name", "reward"), crossed(["planner", "random"], ["oracle", "shaped"], every=2)
)
def test_a_trace_has_the_figures_of_its_agent(name, reward, phantom, tmp_path):
    config = replace(FEW, reward=reward)
    made = record_trace(name, tmp_path, config, tmp_path / "t.json", phantom)
    here = figures(name, tmp_path, config, phantom)
    assert figures(tmp_path / "t.json", tmp_path, config, phantom) == here
    again = (tmp_path / "t.json").read_bytes()
    record_trace(name, tmp_path, config, tmp_path / "t.json", phantom)
    assert (tmp_path / "t.json").read_bytes() == again
    assert made["episodes"] == 12 and here["metrics"]["episode_steps"]["n"] == 12
    assert made["steps"] == pytest.approx(12 * here["metrics"]["episode_steps"]["value"])


def test_a_policys_trace_under_the_papers_reward(phantom, tmp_path):
    """The grader ends the episodes: the replay has to draw what the policy saw."""
    config, grader, agent = replace(FEW, starts=2, reward="paper"), FakeGrader(), policy("image")
    record_trace("ppo", tmp_path, config, tmp_path / "t.json", phantom, grader, agent)
    here = figures("ppo", tmp_path, config, phantom, grader=grader, agent=agent)
    assert figures(tmp_path / "t.json", tmp_path, config, phantom, grader=grader) == here
    assert here["task"]["observation"] == "image"


def test_the_scores_name_the_file(trace, phantom, tmp_path):
    scores = evaluate(str(trace), tmp_path, replace(FEW, latency=60), phantom).scores
    assert scores["agent"] == "trace" and list(scores["weights"]["files"]) == ["t.json"]
    assert "latency" not in scores["metrics"], "a trace decides nothing"


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (replace(FEW, seeds=(0, 1)), "recorded from 6 starts of each of the sets"),
        (replace(FEW, starts=5), "recorded from 6 starts"),
        (replace(FEW, seed=0), "recorded from 6 starts"),
        (replace(FEW, reward="shaped"), 'reward: recorded with "oracle", this is "shaped"'),
        (replace(FEW, view="PL"), "trained for SC .* not for PL"),
    ],
)
def test_other_starts_and_other_tasks_are_refused(trace, phantom, tmp_path, config, message):
    with pytest.raises(RacinesError, match=message):
        evaluate(str(trace), tmp_path, config, phantom)


def test_another_phantom_is_refused(trace, tmp_path):
    """Its recipe tells them apart; stand-ins without one, where the same actions lead."""
    with pytest.raises(RacinesError, match="t.json: set 0, index .: the trace (ends before|goes)"):
        evaluate(str(trace), tmp_path, FEW, FakePhantom(reach=0.5))


def spoil(path, change):
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(extra=1), "keys unknown or missing: extra"),
        (lambda d: d.pop("agent"), "keys unknown or missing: agent"),
        (lambda d: d.update(schema="racines.trace/9"), "schema is not"),
        (lambda d: d.update(task=[]), "task: a list is refused"),
        (lambda d: d["start_set"].update(seeds=[0, 0]), "start_set: give different seeds"),
        (lambda d: d["start_set"].update(starts=10**9), "10,000 episodes in all"),
        (lambda d: d["start_set"].update(starts=True), "start_set"),
        (lambda d: d["episodes"].pop(), "11 episodes: its start set has 2 x 6"),
        (lambda d: d["episodes"].reverse(), "set 2, index 5: expected"),
        (lambda d: d["episodes"][3]["actions"].append(13), "index': 3.*actions: give"),
        (lambda d: d["episodes"][3]["actions"].append(1.0), "actions: give"),
        (lambda d: d["episodes"][3].update(actions=[]), "actions: give"),
        (lambda d: d["episodes"][3].update(seed=1), "give set, index and actions"),
        (lambda d: d.update(agent=float("nan")), "no finite number"),
        (lambda d: d.update(phantom={"version": "9"}), "phantom: recorded with"),
        (lambda d: d["task"].update(hits=1), "task: recorded with"),
        (lambda d: d["episodes"][0]["actions"].pop(), "set 0, index 0: the trace ends before"),
        (lambda d: d["episodes"][5]["actions"].append(0), "set 0, index 5: the trace goes on"),
    ],
)
def test_what_is_no_sound_trace_is_refused(trace, phantom, tmp_path, change, message):
    spoil(trace, change)
    with pytest.raises(RacinesError, match=rf"t\.json: .*{message}"):
        evaluate(str(trace), tmp_path, FEW, phantom)


@pytest.mark.parametrize("text", ["", "[]", "{", "[" * 100_000, '{"a": 1e999}', "\x80\x04K\x01."])
def test_what_is_no_json_is_refused(tmp_path, text):
    (tmp_path / "t.json").write_text(text)
    with pytest.raises(RacinesError, match="t.json: "):
        read_trace(tmp_path / "t.json")
    (tmp_path / "t.json").unlink()
    with pytest.raises(RacinesError, match="no such file"):
        read_trace(tmp_path / "t.json")
    with (tmp_path / "t.json").open("wb") as file:
        file.truncate(10 * 2**30)
    with pytest.raises(RacinesError, match="10,737,418,240 bytes: at most"):
        read_trace(tmp_path / "t.json")


def test_a_trace_is_not_trained(trace):
    with pytest.raises(RacinesError, match="racines export trace"):
        load_agent(str(trace), "").train(None, trace)


PATIENTS = PatientsConfig("A4C-beating", patients=3, starts=2, chunk=2)


class Looking(PlannerAgent):
    """The planner, who is shown images."""

    observation = "image"


@pytest.fixture(scope="module")
def on_patients(tmp_path_factory):
    path = tmp_path_factory.mktemp("patients") / "t.json"
    made = record_on_patients("", path.parent, PATIENTS, path, agent=Looking())
    assert made["episodes"] == 6
    return path


def test_a_trace_on_patients_has_the_figures_of_its_agent(on_patients, tmp_path):
    keys = "metrics", "by_pathology", "task", "phantom", "seeds"
    for config in (PATIENTS, replace(PATIENTS, chunk=3)):
        here = evaluate_patients("", tmp_path, config, agent=Looking()).scores
        played = evaluate_patients(str(on_patients), tmp_path, config).scores
        assert {key: here[key] for key in keys} == {key: played[key] for key in keys}
        assert played["agent"] == "trace" and played["task"]["observation"] == "image"
    rows = json.loads(on_patients.read_text())["episodes"]
    assert [(each["patient"], each["index"]) for each in rows] == [
        (10_000 + patient, index) for patient in range(3) for index in range(2)
    ]
    assert rows[0]["actions"] != rows[1]["actions"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"starts": 1}, "start_set: recorded from .*evaluate from the same"),
        ({"patients": 2}, "start_set: recorded from"),
        ({"split": "train"}, "start_set: recorded from"),
        ({"seed": 1}, "start_set: recorded from"),
        ({"reward": "shaped"}, "reward: recorded with"),
        ({"view": "PL-beating"}, "trained for A4C-beating"),
        ({"view": "A4C-patients"}, "trained for A4C-beating"),
    ],
)
def test_a_trace_on_patients_is_of_its_own_starts(on_patients, tmp_path, changes, message):
    with pytest.raises(RacinesError, match=message):
        evaluate_patients(str(on_patients), tmp_path, replace(PATIENTS, **changes))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda told: told["start_set"].update(patients=0), "start_set: give digest, patients"),
        (lambda told: told["start_set"].update(patients="3"), "start_set: give digest, patients"),
        (lambda told: told["start_set"].update(seeds=[0, 1]), "one seed"),
        (lambda told: told["start_set"].update(split="nowhere"), 't.json: start_set.split: "nowhe'),
        (lambda told: told["start_set"].update(split=None), "start_set.split: null: choose train"),
        (lambda told: told["start_set"].update(split=["x" * 999]), r"split: .{0,81}: choose train"),
        (lambda told: told["task"].update(view="XX"), "t.json: task: view XX, tier .beating.: cho"),
        (
            lambda told: told["task"].update(view="\x1b[2J"),
            "task.view: .*: give the name of a view",
        ),
        (lambda told: told["task"].update(view="A" * 999), "task.view: .{0,82}: give the name"),
        (
            lambda told: told["task"].update(tier="moon"),
            "task: view A4C, tier .moon.: choose",
        ),
        (lambda told: told.update(task={}), 'task.view: "": give the name of a view'),
        (lambda told: told["start_set"].pop("digest"), "start_set: give digest"),
        (lambda told: told["start_set"].update(starts=5000), "10,000 episodes in all"),
        (lambda told: told["episodes"].pop(), "5 episodes: its start set has 3 x 2"),
        (lambda told: told["episodes"][1].update(patient=7), "patient 7, index 1: expected"),
        (lambda told: told["episodes"][1].update(set=0), "give patient, index and actions"),
    ],
)
def test_a_faulty_trace_on_patients_is_refused(on_patients, tmp_path, change, message):
    told = json.loads(on_patients.read_text())
    change(told)
    (tmp_path / "t.json").write_text(json.dumps(told))
    with pytest.raises(RacinesError, match=message):
        read_trace(tmp_path / "t.json")


def test_a_trace_on_patients_ends_with_its_episodes(on_patients, tmp_path):
    for change, message in (
        (lambda actions: actions.pop(), "index 0: the trace ends before its episode"),
        (lambda actions: actions.append(0), "index 0: the trace goes on behind the end"),
    ):
        told = json.loads(on_patients.read_text())
        change(told["episodes"][2]["actions"])
        (tmp_path / "t.json").write_text(json.dumps(told))
        with pytest.raises(RacinesError, match=f"patient 10001, {message}"):
            evaluate_patients(str(tmp_path / "t.json"), tmp_path, PATIENTS)


def test_what_cannot_be_recorded_is_refused_before_anybody_acts(tmp_path, phantom, monkeypatch):
    path, acting = tmp_path / "t.json", Looking()
    monkeypatch.setattr("racines_envs.evaluation.patients._on_chunk", None)
    for config, message in (
        (replace(PATIENTS, seed=-1), "evaluation_patients: seed -1"),
        (replace(PATIENTS, starts=5000), "5000 starts on each: .* 10,000 episodes in all"),
    ):
        with pytest.raises(RacinesError, match=message):
            record_on_patients("", tmp_path, config, path, agent=acting)
    acting.action = "velocity"
    with pytest.raises(RacinesError, match="planner acts by velocity: a trace holds the 13"):
        record_on_patients("", tmp_path, PATIENTS, path, agent=acting)
    monkeypatch.setattr("racines_envs.evaluation.run.rollout", None)
    with pytest.raises(RacinesError, match="planner acts by velocity"):
        record_trace("", tmp_path, FEW, path, phantom, agent=acting)
    assert not path.exists()


def test_a_trace_is_no_agent_where_it_matters_what_is_seen(on_patients, tmp_path):
    config = RobustnessConfig(view="A4C-beating", patients=1, starts=1)
    with pytest.raises(RacinesError, match="a trace looks at nothing: name the agent"):
        evaluate_robustness(str(on_patients), tmp_path, config, tmp_path / "r.json")
    measured = EjectionConfig(view="A4C-beating", patients=1, starts=1)
    with pytest.raises(RacinesError, match="a trace looks at nothing"):
        study_ejection(str(on_patients), tmp_path, measured, cast(Any, None))
