"""The stages: each makes its arrays at a small size, however it is asked to run."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from racines_data.imaging import ImageSource
from racines_leaderboard.determinism.setup import POSES, Arrays, Setup, Stage, Work, in_batches

STARTS = 8
"""Episodes of a rollout."""
SCORED = 16
"""Frames of the scores."""
GRAY = "gray levels"
Make = Callable[[Work, Setup], Arrays]


def stages() -> list[Stage]:
    """Return all stages, a training and a sampling for each registered generator."""
    from racines_models.registry import generator_names

    made = [
        Stage("render", GRAY, render, ("again", "threads", "batch", "cuda")),
        Stage("data build", GRAY, build, ("again", "threads", "workers")),
        Stage("grader, training", "weights", grader_training, ("again", "threads", "cuda")),
        Stage("grader, reading", "probability", grader, ("again", "threads", "batch", "cuda")),
    ]
    for name in generator_names():
        names = (f"{name}, training", f"{name}, drawing", f"{name}, ONNX")
        made.append(Stage(names[0], "weights", _training(name), ("again", "threads", "cuda")))
        drawn = ("again", "threads", "batch", "cuda")
        made.append(Stage(names[1], GRAY, _drawing(name), drawn))
        made.append(Stage(names[2], GRAY, _drawing(name), ("onnx",)))
    return [
        *made,
        Stage("scores", "figures", scores, ("again", "threads")),
        Stage("rollouts", "figures", rollouts, ("again", "threads", "batch", "cuda")),
        Stage("PPO, training", "weights", ppo, ("again", "threads", "cuda")),
    ]


def render(work: Work, setup: Setup) -> Arrays:
    """Scan 64 poses."""
    from racines_data.phantom.config import PhantomConfig
    from racines_data.phantom.model import shared_phantom

    phantom = shared_phantom(PhantomConfig(), setup.device)
    poses, seeds = work.poses.to(setup.device), torch.arange(POSES, device=setup.device)
    drawn = in_batches(lambda rows: phantom.generate(poses[rows], seeds[rows]), setup.batch)
    return {"images": drawn}


def build(work: Work, setup: Setup) -> Arrays:
    """Build a dataset of 240 frames."""
    store = work.build(setup.workers)
    return {"images": store.images, "parameters": store.parameters, "grades": store.grades}


def grader_training(work: Work, setup: Setup) -> Arrays:
    """Train a grader, an epoch a stage."""
    return _state(work.train_grader(setup.device).network)


def grader(work: Work, setup: Setup) -> Arrays:
    """Read 64 frames with a trained grader."""
    judge = work.grader
    judge.network.to(setup.device)
    judge.device = torch.device(setup.device)
    images = work.store.images[:POSES].to(setup.device)
    read = [judge.probabilities_and_grade(part) for part in images.split(setup.batch)]
    judge.network.to("cpu")
    judge.device = torch.device("cpu")
    return {"probabilities": torch.cat([each[0] for each in read]).cpu()}


def _training(name: str) -> Make:
    def train(work: Work, setup: Setup) -> Arrays:
        return {key: each.cpu() for key, each in work.fit(name, setup.device).tensors().items()}

    return train


def _drawing(name: str) -> Make:
    def draw(work: Work, setup: Setup) -> Arrays:
        generator, seeds = work.generator(name), torch.arange(POSES)
        if setup.device == "onnx":
            generator = _as_onnx(work, generator)
        elif setup.device != "cpu":
            generator = _moved(work, generator, setup.device)
        made = in_batches(
            lambda rows: generator.generate(work.poses[rows], seeds[rows]), setup.batch
        )
        return {"images": made}

    return draw


def _as_onnx(work: Work, generator: Any) -> ImageSource:
    from racines_models.exchange.onnx.export import export_generator
    from racines_models.exchange.onnx.generator import OnnxGenerator

    path = work.new().with_suffix(".onnx")
    export_generator(generator, path)
    return OnnxGenerator(path)


def _moved(work: Work, generator: Any, device: str) -> ImageSource:
    """Return the same weights on another device."""
    folder = work.new()
    generator.save(folder)
    return type(generator).load(folder, device)


def scores(work: Work, setup: Setup) -> Arrays:
    """Score the mean image on 16 frames, Inception and a grader included."""
    from racines_models.scores.scoring import ScoresConfig, score

    config = ScoresConfig(samples=SCORED, resamples=50, speed=False)
    mean = work.generator("mean-image")
    content = score(mean, work.store, config, "mean-image", grader=work.grader).content
    numbers = {
        key: [metric[number] for number in ("value", "low", "high")]
        for key, metric in content["metrics"].items()
    }
    return {
        key: torch.tensor([float("nan") if x is None else x for x in row], dtype=torch.float64)
        for key, row in numbers.items()
    }


def rollouts(work: Work, setup: Setup) -> Arrays:
    """Let the planner steer from 8 starts, all at once or one at a time."""
    from racines_envs.agents.planner import PlannerAgent
    from racines_envs.agents.rollout import rollout
    from racines_envs.task.starts import evaluation_seeds
    from racines_envs.worlds.making import make_core

    seeds, size = evaluation_seeds(STARTS, 0), min(setup.batch, STARTS)
    finals: dict[str, list[Tensor]] = {}
    for part in seeds.split(size):
        core = make_core(
            "SC", len(part), observation="params", reward="oracle", device=setup.device
        )
        episodes = rollout(core, PlannerAgent(), part.to(core.device))
        for key, values in episodes.final.items():
            finals.setdefault(key, []).append(torch.as_tensor(values, dtype=torch.float64))
    return {key: torch.cat(values) for key, values in finals.items()}


def ppo(work: Work, setup: Setup) -> Arrays:
    """Train PPO on the pose for two updates."""
    from racines_envs.agents.ppo import PPOAgent, PPOConfig
    from racines_models.weights import load_weights

    config = PPOConfig(
        frames=4096,
        validate_every=4096,
        validation_starts=4,
        threads=setup.threads,
        device=setup.device,
    )
    out = work.new()
    PPOAgent.train(config, out, progress=False)
    return {key: each.cpu() for key, each in load_weights(out / "policy.safetensors").items()}


def _state(network: torch.nn.Module) -> Arrays:
    return {key: value.detach().cpu().clone() for key, value in network.state_dict().items()}
