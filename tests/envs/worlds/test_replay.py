"""Recorded frames in the place of drawn ones, and recordings in the place of a phantom."""

import dataclasses
import json
import shutil
from typing import Any

import numpy as np
import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, geodesic, parameters_to_pose
from racines_data.phantom import PhantomConfig
from racines_data.store.frames import open_store
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.rollout import rollout
from racines_envs.evaluation.run import EvaluationConfig, evaluate
from racines_envs.task.tasks import get_task
from racines_envs.worlds.making import make_core
from racines_envs.worlds.replay import RecordedWorld, Replay, spacing
from racines_models.generators.nearest_pose import NearestPose
from racines_models.judges.grader.annotate import annotate
from racines_models.judges.grader.model import Grader, GraderConfig, GraderNetwork

SETTINGS: dict[str, Any] = {"backend": "replay", "reward": "oracle", "observation": "multimodal"}


@pytest.fixture(scope="module")
def store(tiny_root):
    return open_store(tiny_root)


@pytest.fixture(scope="module")
def release(tiny_root, tmp_path_factory):
    """The tiny dataset as if it were recorded: nobody knows a phantom of it."""
    root = tmp_path_factory.mktemp("release") / "racines"
    shutil.copytree(tiny_root, root, symlinks=False)
    manifest = json.loads((root / "manifest.json").read_text())
    (root / "manifest.json").write_text(json.dumps(manifest | {"source": "release"}))
    return root


def test_the_nearest_frame_is_the_generators_nearest_pose(store):
    replay = Replay(store)
    frames = store.take(store.split_indices("test"))
    index, distance = replay.index.nearest(frames.parameters)
    generator = NearestPose()
    generator.held["keys"] = generator.embed(replay.parameters)
    expected = generator.nearest(frames.parameters)
    assert torch.equal(index, expected[0])
    assert torch.allclose(distance, expected[1], atol=1e-7)
    drawn = replay.generate(frames.parameters, 0)
    assert torch.equal(drawn, store.images[replay.rows][index])
    pose = parameters_to_pose(frames.parameters)
    assert torch.equal(replay.wrench(pose), replay.parameters[index, :6])
    one = replay.generate(frames.parameters[3:4], 9)
    assert torch.equal(one[0], drawn[3])


def test_out_of_support_is_farther_than_recordings_lie_apart(store):
    replay = Replay(store)
    recorded = replay.parameters[::7]
    assert not bool(replay.out_of_support(recorded).any())
    away = recorded.clone()
    away[:, 6] += 2 * replay.threshold
    away[:, 7] += 1.0
    assert bool(replay.out_of_support(away).all())
    trajectory = store.trajectory_index[replay.rows]
    low, high = (spacing(replay.parameters, trajectory, q) for q in (0.5, 0.99))
    assert 0 < low < high == pytest.approx(replay.threshold)
    alone = spacing(replay.parameters, torch.zeros_like(trajectory), 0.5)
    assert 0 < alone < low  # the frame before or after


def test_on_the_phantoms_dataset_the_phantom_says_what_is_true(store, real_phantom):
    core = make_core("SC", 3, data=store.root, phantom=real_phantom, **SETTINGS)
    seen = core.reset(seed=0)
    assert torch.equal(seen["image"], core.images.generate(core.parameters, 0))
    assert core.phantom is real_phantom
    assert torch.equal(core.state.wrench, core.images.wrench(core.state.pose))
    info = core.info()
    assert info["out_of_support"].dtype == torch.bool
    assert torch.equal(info["grade"], real_phantom.judge(core.state.pose).grade)
    contact = make_core(
        "SC", 3, data=store.root, phantom=real_phantom, forces="contact", **SETTINGS
    )
    contact.reset(seed=0)
    assert torch.equal(contact.state.wrench, real_phantom.wrench(contact.state.pose))
    other = PhantomConfig(anatomy_seed=5)
    with pytest.raises(RacinesError, match=r"another phantom.*data_version='any'"):
        make_core("SC", data=store.root, phantom=other, **SETTINGS)


def test_recordings_alone_make_an_environment(release):
    core = make_core("SC", 40, data=release, **SETTINGS)
    world = core.phantom
    assert isinstance(world, RecordedWorld) and world.truth_source == "dataset"
    replay = world.replay
    position = replay.parameters[:, 6:9]
    assert torch.equal(core.phantom.workspace.position_max, position.amax(0))
    assert bool(world.workspace.contains(parameters_to_pose(replay.parameters)).all())
    store, label = replay.store, core.task.target
    grades = torch.where(store.views == label, store.grades, -1.0)[replay.rows]
    index, distance = replay.index.nearest_to(core.target)
    assert distance.item() < 1e-6 and grades[index].item() == grades.max()
    core.reset(seed=0)
    index, distance = replay.index.nearest_to(core.state.pose)
    assert distance.max() < 1e-5  # every start is a recorded pose
    info = core.info()
    assert not bool(info["success"].any()) and not bool(info["out_of_support"].any())
    assert torch.equal(info["view"], store.views[replay.rows][index])
    assert torch.equal(info["grade"], store.grades[replay.rows][index])
    near = world.own_nearest(core.state.pose, label, (0.003, 0.06))
    assert bool((world.judge(near).view == label).all())
    for name in ("view_position_error", "view_rotation_error"):
        assert bool((info[name] >= 0).all()) and bool((info[name] > 0).any())


def test_a_planner_walks_through_recordings_and_the_same_seed_walks_the_same(release):
    task = dataclasses.replace(get_task("SC"), termination="first_hit", max_steps=60)
    core = make_core(task, 5, data=release, **SETTINGS)
    seeds = torch.arange(5)
    first, second = (rollout(core, PlannerAgent(), seeds) for _ in range(2))
    assert (first.positions == second.positions).all()
    away = np.linalg.norm(first.positions[0] - core.target.position.numpy(), axis=-1)
    assert first.final["position_error"].mean() < 0.5 * away.mean()


def test_agents_are_evaluated_on_recordings_alone(release, phantom):
    """The phantom that an evaluation brings is not asked, nor for the shortest way."""
    config = EvaluationConfig(backend="replay", data=str(release), starts=4, seeds=(0,))
    scores = evaluate("planner", release, config, phantom).scores
    assert scores["phantom"] is None
    assert scores["metrics"]["spl"]["value"] == scores["metrics"]["success_true"]["value"]


def test_open_recordings_serve_again(release, store, phantom):
    first = make_core("SC", 2, data=release, **SETTINGS)
    again = make_core("SC", 2, **SETTINGS | {"backend": first.images}, phantom=phantom)
    assert again.images is first.images and isinstance(again.phantom, RecordedWorld)
    assert torch.equal(first.reset(seed=0)["image"], again.reset(seed=0)["image"])
    third = make_core("SC", 2, **SETTINGS | {"backend": first.images}, phantom=first.phantom)
    assert third.phantom is first.phantom
    simulated = make_core("SC", 2, **SETTINGS | {"backend": Replay(store)}, phantom=phantom)
    assert simulated.phantom is phantom


def test_out_of_support_nothing_is_shown(release):
    core = make_core("SC", 1, data=release, **SETTINGS)
    far = Pose(core.target.position + 0.5, core.target.rotation)
    truth = core.phantom.judge(far)
    assert (truth.view.item(), truth.grade.item()) == (5, 0.0)
    assert truth.membership.sum() == truth.view_grade.sum() == 0


def test_recordings_in_place_of_the_phantom_can_be_asked_for(store):
    core = make_core("SC", 1, data=store.root, phantom="recorded", **SETTINGS)
    assert isinstance(core.phantom, RecordedWorld)
    with pytest.raises(RacinesError, match="needs the backend 'replay'"):
        make_core("SC", phantom="recorded", observation="params", reward="oracle")
    with pytest.raises(RacinesError, match=r"forces='contact' needs a phantom"):
        make_core("SC", data=store.root, phantom="recorded", forces="contact", **SETTINGS)


def test_a_graders_opinion_serves_where_the_dataset_has_none(release, tmp_path):
    network = GraderNetwork(32, 0.125)
    Grader(network, GraderConfig(input_size=32, width=0.125, bf16=False)).save(tmp_path / "grader")
    annotate(release, Grader.load(tmp_path / "grader"), tmp_path / "annotated")
    bare, store = open_store(release), open_store(tmp_path / "annotated")
    for each in (bare, store):
        each.views = torch.full_like(each.views, -1)
        each.grades = torch.full_like(each.grades, float("nan"))
    with pytest.raises(RacinesError, match=f"racines data annotate {release}"):
        RecordedWorld(Replay(bare))
    world = RecordedWorld(Replay(store))
    assert world.truth_source == "grader"
    rows = slice(*store.bounds("train"))
    p, grades = Grader.load(tmp_path / "grader").probabilities_and_grade(store.images[rows][:9])
    truth = world.judge(parameters_to_pose(store.parameters[rows][:9]))
    assert torch.equal(truth.view, p.argmax(1))
    shown = truth.view < 5
    assert torch.allclose(truth.grade[shown], grades[shown], atol=1e-4)
    assert bool((truth.grade[~shown] == 0).all())


def test_datasets_that_cannot_be_replayed_are_refused(store, tmp_path, monkeypatch):
    with pytest.raises(RacinesError, match="no dataset here"):
        make_core("SC", data=tmp_path, **SETTINGS)
    with pytest.raises(RacinesError, match=r"labels are A4C.*the abdomen has KLX"):
        make_core("KLX", anatomy="abdomen", data=store.root, **SETTINGS)
    bare = open_store(store.root)
    bare.parameters = torch.full_like(bare.parameters, float("nan"))
    with pytest.raises(RacinesError, match="frames without poses"):
        Replay(bare)
    monkeypatch.setattr(bare, "bounds", lambda split: (0, 0))
    with pytest.raises(RacinesError, match="'train' has no frames to replay"):
        Replay(bare)


def test_starts_lie_where_the_task_says(store):
    world = RecordedWorld(Replay(store))
    task = get_task("SC")
    target, limits = world.target("SC"), (task.start_distance, task.start_angle)
    starts = world.own_starts(task.target, target, torch.arange(50), *limits)
    across = (starts.position - target.position)[:, :2].norm(dim=-1)
    angle = geodesic(starts.rotation, target.rotation)
    position, rotation = parameters_to_pose(world.replay.parameters)
    fits = ((position - target.position)[:, :2].norm(dim=-1) >= task.start_distance[0]).sum()
    assert int(fits) > 0
    if len(set(across.tolist())) > 1:
        assert across.min() >= task.start_distance[0] and across.max() <= task.start_distance[1]
        assert angle.min() >= task.start_angle[0] and angle.max() <= task.start_angle[1]
    assert not bool((world.judge(starts).view == task.target).any())
    again = world.own_starts(task.target, target, torch.tensor([7]), *limits)
    assert torch.equal(again.position[0], starts.position[7])
