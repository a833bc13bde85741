"""Frames and steps a second on one device, at several batch sizes; the fastest counts."""

import json
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import torch

from racines_data.geometry import Pose
from racines_data.patients import Pool
from racines_data.phantom import shared_phantom
from racines_data.randomness import sample_seeds
from racines_data.views import VIEWS
from racines_envs.agents.ppo import PPOAgent, PPOConfig
from racines_envs.task.actions import ACTIONS
from racines_envs.task.core import ScanCore
from racines_envs.worlds.making import make_core
from tests.benchmarks.gpu.correctness import FIRST
from tests.benchmarks.gpu.sizes import Sizes

STUDENT = str(Path(__file__).parents[3] / "models/weights/student")
WARM_UP = 2


def render(device: str, sizes: Sizes, late: Callable[[], bool]) -> dict[str, Any]:
    """Time the renderer at the views' nominal poses."""
    phantom = shared_phantom(None, device)

    def drawing(count: int) -> Callable[[], object]:
        targets = [phantom.target(VIEWS[i % len(VIEWS)]) for i in range(len(VIEWS))]
        rows = torch.arange(count, device=device) % len(VIEWS)
        pose = Pose(*(torch.cat(parts).to(device)[rows] for parts in zip(*targets, strict=True)))
        seeds = sample_seeds(0, count).to(device)
        return lambda: phantom.render(pose, seeds)

    return _best(drawing, sizes.render, "frames_per_second", device, sizes, late)


def hearts(device: str, sizes: Sizes, late: Callable[[], bool]) -> dict[str, Any]:
    """Time the renderer of patients at their nominal poses, which `correctness` has baked."""
    pool = Pool(range(FIRST, FIRST + sizes.hearts), device)

    def drawing(count: int) -> Callable[[], object]:
        rows = torch.arange(count, device=device) % sizes.hearts
        targets = pool.targets(rows)
        each, views = torch.arange(count, device=device), torch.arange(count, device=device) % 5
        pose = type(targets)(*(part[each, views] for part in targets))
        seeds = sample_seeds(0, count).to(device)
        return lambda: pool.render(pose, rows, None, seeds)

    return _best(drawing, sizes.render, "frames_per_second", device, sizes, late)


def images(device: str, sizes: Sizes, late: Callable[[], bool]) -> dict[str, Any]:
    """Time steps from the image, paid by the published student."""
    settings = {"observation": "image", "reward": "paper", "grader": STUDENT}
    return _best(
        lambda count: _stepping(make_core("SC", count, device=device, **settings)),
        sizes.images, "steps_per_second", device, sizes, late,
    )  # fmt: skip


def params(device: str, sizes: Sizes, late: Callable[[], bool]) -> dict[str, Any]:
    """Time steps from the pose, paid by the oracle."""
    settings = {"observation": "params", "reward": "oracle"}
    return _best(
        lambda count: _stepping(make_core("SC", count, device=device, **settings)),
        sizes.params, "steps_per_second", device, sizes, late,
    )  # fmt: skip


def ppo(device: str, sizes: Sizes, late: Callable[[], bool]) -> dict[str, Any]:
    """Time PPO from the image by convolutions of its own, paid by the published student."""
    runs: dict[str, float] = {}
    for envs, every in sizes.ppo:
        if runs and late():
            break
        config = PPOConfig(
            observation="image", reward="paper", grader=STUDENT, envs=envs, update_every=every,
            frames=every * sizes.updates, minibatch=sizes.ppo_minibatch, epochs=5,
            validate_every=1 << 40, validation_starts=1, termination="first_hit", device=device,
        )  # fmt: skip
        with tempfile.TemporaryDirectory() as folder:
            PPOAgent.train(config, Path(folder), progress=False)
            told = json.loads((Path(folder) / "metrics.json").read_text())
        runs[str(envs)] = round(told["frames"] / max(told["seconds"], 0.1), 1)
    return {"steps_per_second": max(runs.values()), "by_environments": runs}


def _stepping(core: ScanCore) -> Callable[[], object]:
    """Return what takes one random step of a core, whose episodes begin anew where they end."""
    count = core.num_envs
    actions = torch.randint(len(ACTIONS), (16, count), device=core.device)
    core.reset(0)
    taken = iter(range(1 << 40))
    return lambda: core.step(actions[next(taken) % len(actions)], autoreset=True)


def _best(
    make: Callable[[int], Callable[[], object]], counts: Iterable[int], name: str, device: str,
    sizes: Sizes, late: Callable[[], bool],
) -> dict[str, Any]:  # fmt: skip
    """Time batches of several sizes until memory or time is up; return the best as `name`."""
    rates: dict[str, float] = {}
    for count in counts:
        if rates and late():
            break
        try:
            rates[str(count)] = round(_rate(make(count), count, device, sizes.seconds), 1)
        except torch.OutOfMemoryError:
            if not rates:
                raise
            break
    return {name: max(rates.values()), "by_batch": rates}


@torch.no_grad()
def _rate(work: Callable[[], object], count: int, device: str, seconds: float) -> float:
    """Return items a second of work that does `count` of them."""
    for _ in range(WARM_UP):
        work()
    began, done = _now(device), 0
    while True:
        for _ in range(8):
            work()
            done += 1
        took = _now(device) - began
        if took >= seconds:
            return count * done / took


def _now(device: str) -> float:
    """Return seconds, after all that the device was asked to do."""
    if device.startswith("cuda"):
        torch.cuda.synchronize(device)
    return time.perf_counter()
