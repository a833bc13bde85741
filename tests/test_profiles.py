"""Every profile fills the dataclasses that its sections name."""

from importlib.metadata import entry_points

import pytest

from racines_data.build.dataset import make_also, make_source, read_data_section
from racines_data.config import PROFILES, fill, read_params, section
from racines_data.phantom import PhantomConfig
from racines_data.store.scouts import ScoutsConfig
from racines_envs.agents import agent_class
from racines_envs.evaluation.agent_specs import find_entry
from racines_envs.evaluation.patients import PatientsConfig
from racines_envs.evaluation.run import EvaluationConfig
from racines_envs.worlds.exploration import ExplorationConfig
from racines_models.judges.grader.model import GraderConfig
from racines_models.judges.pose.regressor import PoseConfig
from racines_models.judges.student.model import StudentConfig
from racines_models.registry import generator_class
from racines_models.scores.on_patients import PatientScoresConfig

ENCODER = "models/runs/encoder"
"""What the stage of that name makes."""


@pytest.mark.parametrize("profile", PROFILES)
def test_every_section_is_known_to_its_owner(profile: str):
    params = read_params(profile=profile)
    config, sources = read_data_section(section(params, "data"))
    make_source(config, sources.get(config.source))
    for source in make_also(config, sources):
        assert source.recipe()
    fill(PhantomConfig, section(params, "data.phantom.phantom"), "data.phantom.phantom")
    fill(GraderConfig, section(params, "grader"), "grader")
    fill(StudentConfig, section(params, "student"), "student")
    fill(PoseConfig, section(params, "pose"), "pose")
    fill(EvaluationConfig, section(params, "evaluation"), "evaluation")
    fill(ExplorationConfig, section(params, "encoder"), "encoder")
    registered = {point.name for point in entry_points(group="racines.generators")}
    assert set(params["generators"]) <= registered
    for name in params["generators"]:
        path = f"generators.{name}"
        fill(generator_class(name).Config, section(params, path), path)
    assert set(params["patient_generators"]) <= registered
    for name in params["patient_generators"]:
        path = f"patient_generators.{name}"
        fill(generator_class(name).Config, section(params, path), path)
    assert fill(ScoutsConfig, section(params, "scouts"), "scouts").count
    fill(PatientScoresConfig, section(params, "patient_scores"), "patient_scores")
    fill(PatientsConfig, section(params, "evaluation_patients"), "evaluation_patients")
    for name in [*params["agents"], *params["patient_agents"]]:
        entry = find_entry(params, name)
        fill(agent_class(entry.agent).Config, entry.settings, entry.where)
        assert entry.name == name
        assert entry.settings.get("encoder") in (None, "", ENCODER)
