"""Every profile fills the dataclasses that its sections name."""

from importlib.metadata import entry_points

import pytest

from racines_data.build import make_source, read_data_section
from racines_data.config import PROFILES, fill, read_params, section
from racines_data.phantom import PhantomConfig
from racines_envs.agents import agent_class
from racines_envs.evaluation import EvaluationConfig
from racines_models.grader import GraderConfig
from racines_models.pose_regressor import PoseConfig
from racines_models.registry import generator_class
from racines_models.student import StudentConfig


@pytest.mark.parametrize("profile", PROFILES)
def test_every_section_is_known_to_its_owner(profile: str):
    params = read_params(profile=profile)
    config, sources = read_data_section(section(params, "data"))
    make_source(config, sources.get(config.source))
    fill(PhantomConfig, section(params, "data.phantom.phantom"), "data.phantom.phantom")
    fill(GraderConfig, section(params, "grader"), "grader")
    fill(StudentConfig, section(params, "student"), "student")
    fill(PoseConfig, section(params, "pose"), "pose")
    fill(EvaluationConfig, section(params, "evaluation"), "evaluation")
    for group, named in (("generators", generator_class), ("agents", agent_class)):
        assert set(params[group]) <= {
            point.name for point in entry_points(group=f"racines.{group}")
        }
        for name in params[group]:
            path = f"{group}.{name}"
            fill(named(name).Config, section(params, path), path)
