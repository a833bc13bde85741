"""Agents that look through a frozen pose regressor."""

import shutil
from dataclasses import replace

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from racines_data.errors import RacinesError
from racines_data.geometry import parameters_to_pose, pose_to_parameters
from racines_data.store.frames import open_store
from racines_data.views import VIEWS
from racines_envs import ScanEnv
from racines_envs.agents import load_agent
from racines_envs.agents.networks import open_encoder
from racines_envs.agents.ppo import PPOAgent, PPOConfig
from racines_envs.agents.rollout import rollout
from racines_envs.task.starts import evaluation_seeds
from racines_envs.worlds.exploration import ExplorationConfig, explore, train_encoder
from racines_envs.worlds.making import make_core
from racines_models.generators.mean_image import MeanImage
from racines_models.judges.pose.regressor import (
    PoseConfig,
    PoseNetwork,
    PoseRegressor,
    PoseTraining,
)
from racines_models.networks.batching import in_fixed_batches
from racines_models.protocol import Run
from racines_models.provenance import weights_sha256
from tests.envs.fakes import FakePhantom
from tests.models.conftest import pictures
from tests.variants import first_of

TINY = PPOConfig(
    observation="image", frames=512, envs=16, update_every=256, minibatch=128, epochs=1,
    hidden=(16, 16), validate_every=256, validation_starts=4,
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pose")
    torch.manual_seed(0)
    network = PoseNetwork(64, 0.125)
    PoseRegressor(network, PoseConfig(width=0.125)).save(folder)
    return folder


@pytest.mark.parametrize("observation", ["image", "multimodal"])
def test_the_environment_shows_what_the_encoder_says_of_each_image(phantom, folder, observation):
    encoder = open_encoder(str(folder))
    core = make_core(
        "SC", 5, observation=observation, reward="shaped", phantom=phantom, encoder=encoder
    )
    seen = core.reset(seed=0)
    for action in (2, 4, 8):
        assert torch.equal(seen["features"], in_fixed_batches(encoder, seen["image"]))
        seen = core.step(torch.full((5,), action)).observation
    core.reset(mask=torch.tensor([True, False, False, False, True]))
    assert torch.allclose(core.observe()["features"], encoder(core.picture()), atol=1e-5)


def test_torchrl_sees_features_instead_of_images(phantom, folder):
    encoder = open_encoder(str(folder))
    env = ScanEnv(
        "SC", 3, observation="multimodal", reward="shaped", phantom=phantom, encoder=encoder
    )
    check_env_specs(env)
    seen = env.reset()
    assert seen["features"].shape == (3, 9) and "image" not in seen and "params" in seen


@pytest.mark.usefixtures("short_episodes")
@pytest.mark.parametrize("observation", first_of(["multimodal", "image"]))
def test_ppo_acts_on_images_alone_after_training_on_features(
    phantom, folder, tmp_path, observation
):
    config = replace(TINY, encoder=str(folder), observation=observation)
    trained = PPOAgent.train(config, tmp_path, phantom=phantom, progress=False)
    loaded = load_agent("ppo", tmp_path)
    core = make_core("SC", 6, observation=observation, reward="shaped", phantom=phantom)
    first, second = (rollout(core, agent, evaluation_seeds(6)) for agent in (trained, loaded))
    assert (first.positions == second.positions).all()
    seen = core.reset(seed=1)
    image = seen["image"].float().requires_grad_()
    loaded.logits({**seen, "image": image}).sum().backward()
    assert image.grad is not None and float(image.grad.abs().sum()) > 0


@pytest.mark.usefixtures("short_episodes")
def test_a_policy_finds_its_encoder_by_hash_and_refuses_another(phantom, folder, tmp_path):
    named = shutil.copytree(folder, tmp_path / "named")
    config = replace(TINY, encoder=str(named), frames=256)
    PPOAgent.train(config, tmp_path / "run", phantom=phantom, progress=False)
    torch.manual_seed(1)
    other = PoseRegressor(PoseNetwork(64, 0.125), PoseConfig(width=0.125))
    other.save(tmp_path / "run" / "encoder")
    loaded = load_agent("ppo", tmp_path / "run")
    assert loaded.encoder.sha256 == open_encoder(str(folder)).sha256
    other.save(named)
    with pytest.raises(RacinesError, match="trained with another encoder"):
        load_agent("ppo", tmp_path / "run")


def test_an_absent_encoder_is_named():
    assert open_encoder("") is None
    with pytest.raises(RacinesError, match="racines train encoder"):
        open_encoder("nowhere")


class Pictured(FakePhantom):
    """Draws blobs that follow the pose."""

    def render(self, pose, seeds):
        return pictures(pose_to_parameters(pose))


@pytest.mark.thorough
def test_an_encoder_learns_where_the_probe_is(tmp_path):
    """It reads positions better than the middle of all would be."""
    training = PoseTraining(images=1600, batch_size=32, precision="fp32", ema=0.0, warmup_images=64)
    config = ExplorationConfig(frames=600, pose=PoseConfig(width=0.125, training=training))
    phantom = Pictured()
    metrics = train_encoder(config, Run(tmp_path, device="cpu", progress=False), phantom)
    assert metrics["exploration"]["kept"] > 400
    encoder = open_encoder(str(tmp_path))
    assert encoder is not None
    frames = explore(config, phantom, seed=1)
    told = parameters_to_pose(frames.parameters).position
    read = PoseRegressor.load(tmp_path).predict(frames.images).position
    middle = told.mean(0)
    assert (read - told).norm(dim=1).mean() < 0.7 * (middle - told).norm(dim=1).mean()
    assert encoder(frames.images).shape == (len(told), encoder.size)


def test_exploration_may_look_at_what_a_generator_draws(phantom, tiny_root, tmp_path):
    folder = tmp_path / "mean-image"
    folder.mkdir()
    mean = MeanImage()
    mean.fit(open_store(tiny_root), Run(folder, device="cpu", progress=False))
    frames = explore(ExplorationConfig(frames=300, generator=str(folder)), phantom, seed=0)
    scanned = explore(ExplorationConfig(frames=300), phantom, seed=0)
    assert torch.equal(frames.parameters, scanned.parameters)
    assert torch.equal(frames.images, mean.generate(frames.parameters, 0))
    told, plain = (each.manifest["recipe_digest"] for each in (frames, scanned))
    assert list(told.pop("generator").values()) == list(weights_sha256(folder).values())
    assert told == plain
    with pytest.raises(RacinesError, match="nothing"):
        explore(ExplorationConfig(generator="nothing"), phantom, seed=0)


def test_exploration_reaches_from_starts_to_targets_inside_the_workspace(phantom):
    frames = explore(ExplorationConfig(frames=1300), phantom, seed=0)
    pose = parameters_to_pose(frames.parameters)
    assert bool(phantom.workspace.contains(pose).all())
    places = torch.stack([phantom.target(view).position[0] for view in VIEWS])
    away = (pose.position[:, None] - places).norm(dim=-1).amin(1)
    assert float(away.quantile(0.05)) < 0.012 and float(away.quantile(0.9)) > 0.02
    again = explore(ExplorationConfig(frames=1300), phantom, seed=0)
    assert torch.equal(frames.images, again.images)
    sizes = [len(frames.split_indices(name)) for name in ("train", "validation", "test")]
    assert sum(sizes) == len(frames.images) and min(sizes) > 30
