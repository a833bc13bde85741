"""The stages: each makes its arrays at a small size, however it is asked to run.

Libraries that take seconds to load are imported where they are used: a report has many processes.
"""

import contextlib
import copy
import functools
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_data.config import fill, section
from racines_data.phantom.config import PhantomConfig
from racines_data.phantom.model import shared_phantom
from racines_data.store.frames import FrameStore, open_store
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.rollout import rollout
from racines_envs.task.starts import evaluation_seeds
from racines_envs.worlds.making import make_core
from racines_models.exchange.onnx.generator import OnnxGenerator, export_generator
from racines_models.judges.grader.model import Grader, GraderConfig
from racines_models.protocol import Run
from racines_models.registry import generator_class, generator_names, load_generator
from racines_models.sample import spread_sample
from racines_models.weights import load_weights

Arrays = dict[str, Tensor]
POSES = 64
FRAMES = 240
"""Of the dataset that is built for the report."""
STARTS = 8
"""Episodes of a rollout."""
SCORED = 16
"""Frames of the scores."""
FIGURES = ("value", "low", "high")
"""Of each metric."""
SETTINGS: dict[str, Any] = {
    "data": {"frames": FRAMES, "workers": 1, "phantom": {"shortest": 10, "longest": 20}},
    "grader": {"input_size": 32, "view_stage": {"epochs": 1}, "grade_stage": {"epochs": 1}},
    "ppo": {"frames": 4096, "validate_every": 4096, "validation_starts": 4},
}
TRAINING: dict[str, Any] = {"images": 24, "batch_size": 8, "ema": 0.0, "warmup_images": 0}
"""Of each generator that trains: three steps."""
SMALL: dict[str, dict[str, Any]] = {
    "vae-gan": {"width": 8, "encoder_width": 4, "discriminator_width": 4},
    "scene-field": {"voxel": 0.008, "coarse_voxel": 0.02},
    "flow": {"width": 16},
}
"""Sizes of the networks that are slow at their own."""
SETS = ("aten-default", "aten-avx2", "aten-avx512", "onednn-avx2", "onednn-avx512")
TWICE = ("again", "process", "threads", *SETS)
TRAINED = (*TWICE, "cuda")
BATCHED = (*TWICE, "batch", "cuda")


@dataclass(frozen=True)
class Setup:
    """One way to run a stage."""

    threads: int = 1
    batch: int = POSES
    workers: int = 1
    device: str = "cpu"


@dataclass(frozen=True)
class Stage:
    """One stage of the benchmark."""

    name: str
    unit: str
    """Of the largest difference."""
    make: Callable[["Work", Setup], Arrays]
    """What it makes; equal arrays are equal results."""
    compared: tuple[str, ...]
    """The variants, of `run.VARIANTS`, that it is compared in."""


class Work:
    """A folder, and what is made in it once for all stages, processes included.

    What a stage starts from (the dataset, a trained grader, a fitted generator) is made by the
    first that asks, under a name of its own, and opened by all others: they differ in what they
    make of it alone.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.generator = functools.cache(self._generator)
        """A generator of a few steps, fitted once."""

    def new(self) -> Path:
        """Return a path that nothing has been written to."""
        return self.folder / uuid.uuid4().hex

    def build(self, workers: int, out: Path | None = None) -> FrameStore:
        """Build the small dataset anew, and open it."""
        from racines_data.build import dataset

        settings, out = section(SETTINGS, "data") | {"workers": workers}, out or self.new()
        config, sections = dataset.read_data_section(settings)
        dataset.build(dataset.make_source(config, sections.get(config.source)), out, config)
        return open_store(out)

    @functools.cached_property
    def store(self) -> FrameStore:
        """The small dataset."""
        place = self.folder / "data"
        return open_store(place) if place.is_dir() else self.build(1, place)

    @functools.cached_property
    def poses(self) -> Tensor:
        """(64, 12) parameters of its test frames."""
        return spread_sample(self.store, torch.arange(FRAMES), POSES).frames.parameters

    @functools.cached_property
    def grader(self) -> Grader:
        """A grader of one epoch."""
        place = self.folder / "grader"
        return Grader.load(place, "cpu") if place.is_dir() else self.train_grader("cpu", place)

    def train_grader(self, device: str, out: Path | None = None) -> Grader:
        """Train the small grader anew."""
        from racines_models.judges.grader.training import train_grader

        config, out = fill(GraderConfig, SETTINGS["grader"], "grader"), out or self.new()
        train_grader(self.store, config, Run(out, 0, device, progress=False))
        return Grader.load(out, device)

    def _generator(self, name: str) -> Any:
        place = self.folder / f"generator-{name}"
        return load_generator(name, place) if place.is_dir() else self.fit(name, "cpu", place)

    def fit(self, name: str, device: str, out: Path | None = None) -> Any:
        """Fit a generator anew."""
        cls, out = generator_class(name), out or self.new()
        trains = "training" in {each.name for each in fields(cls.Config)}
        settings = SMALL.get(name, {}) | ({"training": TRAINING} if trains else {})
        config: Any = fill(cls.Config, settings, name)
        cls(config).fit(self.store, Run(out, 0, device, progress=False))
        return load_generator(name, out, device)


@contextlib.contextmanager
def threads(count: int) -> Iterator[None]:
    """Let torch use some threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def in_batches(make: Callable[[slice], Tensor], batch: int, count: int = POSES) -> Tensor:
    """Return what `make` gives of `count` rows, asked for `batch` rows at a time."""
    batches = [make(slice(start, start + batch)).cpu() for start in range(0, count, batch)]
    return torch.cat(batches)


def stages() -> list[Stage]:
    """Return all stages, a training and a sampling for each registered generator."""
    gray, weights = "gray levels", "weights"
    made = [
        Stage("render", gray, render, BATCHED),
        Stage("data build", gray, build, (*TWICE, "workers")),
        Stage("grader, training", weights, grader_training, TRAINED),
        Stage("grader, reading", "probability", grader, BATCHED),
    ]
    for name in generator_names():
        draw = functools.partial(drawing, name)
        made += [
            Stage(f"{name}, training", weights, functools.partial(training, name), TRAINED),
            Stage(f"{name}, drawing", gray, draw, BATCHED),
            Stage(f"{name}, ONNX", gray, draw, ("onnx",)),
        ]
    return [
        *made,
        Stage("scores", "figures", scores, TWICE),
        Stage("rollouts", "figures", rollouts, BATCHED),
        Stage("evaluate and collect", "figures", collected, TWICE),
        Stage("PPO, training", weights, ppo, TRAINED),
    ]


def render(work: Work, setup: Setup) -> Arrays:
    """Scan 64 poses."""
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
    return _on_cpu(work.train_grader(setup.device).network.state_dict())


def grader(work: Work, setup: Setup) -> Arrays:
    """Read 64 frames with a trained grader."""
    judge = copy.deepcopy(work.grader)
    judge.network.to(setup.device)
    judge.device = torch.device(setup.device)
    images = work.store.images[:POSES].to(setup.device)
    read = [judge.probabilities_and_grade(part) for part in images.split(setup.batch)]
    return {"probabilities": torch.cat([each[0] for each in read]).cpu()}


def training(name: str, work: Work, setup: Setup) -> Arrays:
    """Fit a generator."""
    return _on_cpu(work.fit(name, setup.device).tensors())


def drawing(name: str, work: Work, setup: Setup) -> Arrays:
    """Draw 64 images with a trained generator."""
    generator, seeds, place = work.generator(name), torch.arange(POSES), work.new()
    if setup.device == "onnx":
        path = place.with_suffix(".onnx")
        export_generator(generator, path)
        generator = OnnxGenerator(path)
    elif setup.device != "cpu":
        generator.save(place)
        generator = type(generator).load(place, setup.device)
    made = in_batches(lambda rows: generator.generate(work.poses[rows], seeds[rows]), setup.batch)
    return {"images": made}


def scores(work: Work, setup: Setup) -> Arrays:
    """Score the mean image on 16 frames, Inception and a grader included."""
    from racines_models.scores.scoring import ScoresConfig, score

    config = ScoresConfig(samples=SCORED, resamples=50, speed=False)
    mean = work.generator("mean-image")
    content = score(mean, work.store, config, "mean-image", grader=work.grader).content
    return {
        key: torch.from_numpy(np.array([metric[figure] for figure in FIGURES], np.float64))
        for key, metric in content["metrics"].items()
    }


def rollouts(work: Work, setup: Setup) -> Arrays:
    """Let the planner steer from 8 starts, all at once or one at a time."""
    finals: dict[str, list[Tensor]] = {}
    for part in evaluation_seeds(STARTS, 0).split(min(setup.batch, STARTS)):
        core = make_core(
            "SC", len(part), observation="params", reward="oracle", device=setup.device
        )  # fmt: skip
        episodes = rollout(core, PlannerAgent(), part.to(core.device))
        for key, values in episodes.final.items():
            finals.setdefault(key, []).append(torch.as_tensor(values, dtype=torch.float64))
    return {key: torch.cat(values) for key, values in finals.items()}


def collected(work: Work, setup: Setup) -> Arrays:
    """Evaluate the planner from 8 starts, and collect its scores into a board."""
    from racines_envs.evaluation.run import EvaluationConfig, evaluate, write_evaluation
    from racines_leaderboard.board.collect import collect, read_record
    from racines_leaderboard.records.tracks import TRACK
    from racines_models.statistics import Evidence

    place = work.new()
    config = EvaluationConfig(starts=STARTS, seeds=(0,), latency=0)
    (place / "scores").mkdir(parents=True)
    evaluated = evaluate("planner", place, config, board="small")
    write_evaluation(evaluated, place / "scores/planner.json", None)
    (path,) = collect([place / "scores"], place / "results", place / "submissions", "small")
    metrics = read_record(path, "small", TRACK["agents"])["scores"]["metrics"]
    kept = Evidence.read(path.with_suffix(".parquet")).figures
    arrays = {name: np.array([each[key] for key in FIGURES]) for name, each in metrics.items()}
    arrays |= {f"{name}, each": one.values for name, one in kept.items() if one.values is not None}
    return {name: torch.from_numpy(each.astype(np.float64)) for name, each in arrays.items()}


def ppo(work: Work, setup: Setup) -> Arrays:
    """Train PPO on the pose for two updates."""
    from racines_envs.agents.ppo import PPOAgent, PPOConfig

    here, out = {"threads": setup.threads, "device": setup.device}, work.new()
    config: Any = fill(PPOConfig, SETTINGS["ppo"] | here, "ppo")
    PPOAgent.train(config, out, progress=False)
    return _on_cpu(load_weights(out / "policy.safetensors"))


def _on_cpu(tensors: Any) -> Arrays:
    return {key: tensor.detach().cpu() for key, tensor in tensors.items()}
