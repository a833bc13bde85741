"""Any imported dataset: tracked sweeps, a table of poses, a release, annotated frames."""

import math
from pathlib import Path
from typing import Any, ClassVar

import pytest
import torch

from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.export.registry import load_exporter
from racines_data.sources.release import ReleaseSource
from racines_data.sources.table import TableSource
from racines_data.sources.tracked.source import TrackedSource
from racines_data.store.frames import open_store
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.rollout import rollout
from racines_envs.worlds.making import make_core
from racines_envs.worlds.recorded import ReplayConfig, open_recordings
from racines_models.judges.grader.annotate import annotate
from racines_models.protocol import Judge
from tests.data.sources.table_folder import QUATERNIONS, changed, synthetic_folder, write_mapping
from tests.data.sources.test_tracked import SPINE, needs_real


class Bright(Judge):
    """Calls bright frames PL, and dark ones Random."""

    settings: ClassVar[dict[str, Any]] = {"id": "bright", "sha256": "cd" * 32}
    sha256 = "cd" * 32

    def __init__(self, least: float) -> None:
        self.least = least

    def probabilities_and_grade(self, images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        bright = images.float().mean((1, 2)) > self.least
        label = torch.where(bright, 2, 5)
        grade = torch.where(bright, 8.0, 0.0)
        return torch.nn.functional.one_hot(label, 6).float(), grade


def reached(world) -> float:
    core = make_core(world.aim.view, 10, phantom=world, observation="image")
    episodes = rollout(core, PlannerAgent(), torch.arange(10))
    assert bool(world.workspace.contains(core.state.pose).all())
    return float(episodes.final["success"].mean())


@pytest.fixture(scope="module")
def release(tiny_root, tmp_path_factory) -> Path:
    """The tiny dataset in the published layout, imported again; its folders are taken as views."""
    folder = tmp_path_factory.mktemp("release")
    load_exporter("release")(tiny_root, folder / "tree")
    source = ReleaseSource.from_config({"label_views": True}, [folder / "tree"])
    build(source, folder / "set", DataConfig(workers=1))
    return folder / "set"


def test_a_release_layout_folder_is_replayed_by_its_labels(release):
    world = open_recordings(release, "SC")
    assert world.frames.labelled_by == "dataset" and not world.frames.graded
    assert reached(world) >= 0.9


def test_a_release_without_labels_is_replayed_by_a_goal_or_by_what_a_grader_says(
    release, tiny_root, tmp_path
):
    load_exporter("release")(tiny_root, tmp_path / "tree")
    source = ReleaseSource.from_config({}, [tmp_path / "tree"])
    build(source, tmp_path / "set", DataConfig(workers=1))
    with pytest.raises(RacinesError, match="bear no view, and no goal is given") as error:
        open_recordings(tmp_path / "set", "SC")
    name = str(error.value).split("replay.goal, as ")[1].split(",")[0]
    assert reached(open_recordings(tmp_path / "set", "", ReplayConfig(goal=name))) >= 0.9
    bright = Bright(float(open_store(tmp_path / "set").images.float().mean((1, 2)).median()))
    annotate(tmp_path / "set", bright, tmp_path / "annotated")
    store = open_store(tmp_path / "annotated")
    world = open_recordings(store, "PL")
    assert world.frames.labelled_by == "grader" and world.frames.graded
    labels = bright.probabilities_and_grade(store.images)[0].argmax(1)
    assert torch.equal(world.frames.views, labels) and len(labels.unique()) == 2


@needs_real
def test_a_tracked_sweep_is_replayed_by_a_goal_frame(tmp_path):
    build(TrackedSource.from_config({}, [SPINE]), tmp_path / "set", DataConfig(workers=1))
    store = open_store(tmp_path / "set")
    assert not bool((store.views >= 0).any())
    name = f"{store.trajectories[2]}:1"
    world = open_recordings(store, "", ReplayConfig(goal=name, within=3.0))
    assert world.recipe["aim"] == {"view": "Goal", "by": "pose", "frame": name}
    assert reached(world) == 1.0
    core = make_core("Goal", 1, phantom=world)
    image = core.reset(seed=0)["image"]
    assert bool((store.images == image).flatten(1).all(1).any())


def test_a_table_is_replayed_by_a_goal_frame(tmp_path):
    folder = synthetic_folder(tmp_path / "mine")
    write_mapping(folder, changed(QUATERNIONS, frame="robot", segments=4))
    build(TableSource.from_config({}, [folder]), tmp_path / "set", DataConfig(workers=1))
    store = open_store(tmp_path / "set")
    row = len(store) // 2
    name = f"{store.trajectories[int(store.trajectory_index[row])]}:{int(store.frame[row])}"
    world = open_recordings(store, "", ReplayConfig(goal=name, within=4.0))
    assert math.isfinite(world.reach) and reached(world) >= 0.9
