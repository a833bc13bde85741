"""Agents on patients: fixed starts, chunks that decide nothing, floors, and who may not act."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from racines_data.errors import RacinesError
from racines_envs.agents.blind import BlindConfig, BlindTourAgent, ConstantPoseAgent
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.ppo import PPOAgent, PPOConfig
from racines_envs.evaluation.measures import METRICS, patient_values
from racines_envs.evaluation.patients import PatientsConfig, evaluate_patients, start_set
from racines_leaderboard.records.ranges import range_of

NOWHERE = Path("nowhere")  # of agents without weights
CONFIG = PatientsConfig(view="A4C-patients", patients=3, starts=2, chunk=2)


@pytest.fixture(scope="module")
def scored():
    return evaluate_patients("planner", NOWHERE, CONFIG)


def test_the_planner_succeeds_and_all_is_told(scored):
    told = scored.scores["metrics"]
    assert told["success_declared"]["value"] == told["declared"]["value"] == 1.0
    assert told["false_declarations"]["value"] == 0.0
    assert told["position_error_median"]["value"] < 12.0
    quartiles = [told[f"position_error_{name}"]["value"] for name in ("quartile", "upper_quartile")]
    assert quartiles[0] <= told["position_error_median"]["value"] <= quartiles[1]
    assert told["seconds"]["value"] == pytest.approx(told["episode_steps"]["value"] / 10)
    assert set(scored.scores["by_pathology"]) <= {
        "healthy", "dilated", "hypertrophied", "small", "atria", "right"
    }  # fmt: skip


def test_only_who_says_it_at_the_view_succeeds():
    """Four ends: declared there, declared elsewhere, there without a word, passed through."""
    final = dict.fromkeys(
        ("seconds", "steps", "position_error", "rotation_error", "score", "return", "peak_force",
         "mean_force", "workspace_hits", "force_hits"), np.zeros(4)
    )  # fmt: skip
    final |= {
        "success": np.array([1, 0, 1, 0]),
        "declared": np.array([1, 1, 0, 0]),
        "reached": np.ones(4),
    }
    told = patient_values([final])
    assert told["success_declared"].tolist() == [[1, 0, 0, 0]]
    assert told["success_true"].tolist() == [[1, 0, 1, 0]]
    assert told["false_declarations"].tolist() == [[0, 1, 0, 0]]
    assert told["reached"].tolist() == [[1, 1, 1, 1]]


def test_patients_are_the_units(scored):
    figures = scored.evidence.figures["success_declared"]
    assert figures.units.tolist() == [10_000, 10_000, 10_001, 10_001, 10_002, 10_002]


def test_chunks_and_company_decide_nothing(scored):
    whole = evaluate_patients("planner", NOWHERE, replace(CONFIG, chunk=3))
    assert whole.evidence.to_bytes() == scored.evidence.to_bytes()
    fewer = evaluate_patients("planner", NOWHERE, replace(CONFIG, patients=2))
    for name, figures in fewer.evidence.figures.items():
        if figures.values is not None:
            np.testing.assert_array_equal(
                figures.values, scored.evidence.figures[name].values[..., :4]
            )


def test_a_start_set_has_a_digest_of_all_that_decides_it():
    told = [start_set(c).told(c)["digest"] for c in (CONFIG, replace(CONFIG, chunk=1))]
    assert told[0] == told[1]
    for change in ({"seed": 1}, {"starts": 3}, {"view": "SC-patients"}, {"split": "test"}):
        other = replace(CONFIG, **change)
        assert start_set(other).told(other)["digest"] != told[0], change
    assert len(start_set(CONFIG).seeds.unique()) == 6


@pytest.mark.parametrize(
    "change, words",
    [
        ({"split": "nobody"}, "unknown split"),
        ({"split": "test", "patients": 141}, "1 to 140"),
        ({"patients": 140, "chunk": 140}, "100 fit"),
        ({"view": "A4C"}, "has one heart"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_is_made(change, words):
    with pytest.raises(RacinesError, match=words):
        evaluate_patients("planner", NOWHERE, replace(CONFIG, **change))


def test_a_policy_of_the_one_heart_is_refused_by_its_observation(tmp_path):
    from racines_envs.agents.policy import make_actor

    config = PPOConfig(view="A4C", observation="image")
    PPOAgent(config, make_actor(config)).save(tmp_path, {}, 0)
    with pytest.raises(RacinesError, match="trained for A4C and observes image"):
        evaluate_patients("ppo", tmp_path, CONFIG)


def test_one_heart_has_no_patients_to_tell(tmp_path):
    from racines_envs.agents.policy import told_settings

    assert "patients" not in told_settings(PPOConfig(view="SC"))
    assert told_settings(PPOConfig(view="SC-patients"))["patients"] == 64


@pytest.fixture(scope="module")
def floors(tmp_path_factory):
    folder = tmp_path_factory.mktemp("floor")
    agent = ConstantPoseAgent.train(BlindConfig(patients=2, waypoints=3), folder)
    return agent, BlindTourAgent.load(folder)


def test_floors_go_blind_and_declare(floors):
    constant, tour = (
        evaluate_patients("floor", NOWHERE, CONFIG, agent=agent).scores["metrics"]
        for agent in floors
    )
    assert constant["declared"]["value"] == tour["declared"]["value"] == 1.0
    assert tour["episode_steps"]["value"] > constant["episode_steps"]["value"]


def test_ppo_learns_on_train_patients(tmp_path):
    config = PPOConfig(
        view="SC-patients", patients=2, frames=256, envs=8, update_every=128, epochs=1,
        validate_every=256, validation_starts=4,
    )  # fmt: skip
    agent = PPOAgent.train(config, tmp_path, progress=False)
    assert agent.view == "SC-patients"
    assert PPOAgent.load(tmp_path).config.patients == 2
    with pytest.raises(RacinesError, match="SC-patients"):
        evaluate_patients("ppo", tmp_path, CONFIG)


def test_the_planner_acts_for_each_row_by_its_own_patient(still):
    from racines_envs.agents.rollout import rollout
    from racines_envs.worlds.making import make_core

    core = make_core("AnyView-patients", 8, observation="params", phantom=still)
    assert rollout(core, PlannerAgent(), torch.arange(8)).final["success"].all()


def test_what_is_measured_on_patients_is_what_a_record_may_say(scored):
    for name in scored.scores["metrics"]:
        whole = name.removesuffix("_median").removesuffix("_quartile").removesuffix("_upper")
        assert range_of(name) == METRICS[whole][2:], name
