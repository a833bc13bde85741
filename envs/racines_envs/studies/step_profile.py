"""How many steps a second an environment makes, and where the time of a step goes.

Steps a second are taken first, with nothing attached. Then the parts of the core are replaced by
ones that time themselves; the core knows nothing of it and is no slower when nobody measures.
"""

import os
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from racines_data.errors import RacinesError
from racines_envs.apis.gym_env import VectorScanEnv
from racines_envs.task.actions import ACTIONS
from racines_envs.task.core import ScanCore
from racines_envs.worlds.making import WorldLike
from racines_models.devices import on_device

SCHEMA = "racines.speed/1"
PHASES = ("render", "grade", "truth", "contact", "reward", "rest")
"""Drawing; the grader; the oracle; forces; the reward's formula; moves, limits, infos, copies."""
WARM_UP = 2


@dataclass(frozen=True)
class SpeedConfig:
    """What is timed, and how long."""

    view: str = "SC"
    """Target view."""
    observation: str = "image"
    reward: str = "oracle"
    backend: str = "phantom"
    generator: str | None = None
    grader: str | None = None
    """Run folder of a grader or a student, for reward `paper`."""
    num_envs: tuple[int, ...] = (1, 64)
    """Batch sizes."""
    steps: int = 20
    """Steps of all rows a round."""
    rounds: int = 5
    """Rounds without timers inside, whose median counts; one more is taken with them."""
    operations: int = 5
    """Operations of the tensor library that are listed, the longest first."""
    device: str = "cpu"

    def __post_init__(self) -> None:
        least = min(self.steps, self.rounds, *(self.num_envs or (0,)))
        if least < 1 or self.operations < 0:
            told = "speed: num_envs, steps and rounds are 1 or more, operations 0 or more"
            raise RacinesError(told)


class Stopwatch:
    """Adds up the seconds of named phases; what a timed call calls counts as that call's."""

    def __init__(self, device: torch.device) -> None:
        self.seconds: dict[str, float] = dict.fromkeys(PHASES, 0.0)
        self._device, self._inside = device, False

    def now(self) -> float:
        """Return seconds, after all that the device was asked to do."""
        if self._device.type == "cuda":
            torch.cuda.synchronize(self._device)
        return time.perf_counter()

    def timed(self, phase: str, work: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that does the work and notes its time."""

        def run(*arguments: Any, **named: Any) -> Any:
            if self._inside:
                return work(*arguments, **named)
            began, self._inside = self.now(), True
            try:
                return work(*arguments, **named)
            finally:
                self.seconds[phase] += self.now() - began
                self._inside = False

        return run


class _Timed:
    """An object with some methods timed, as are those of what others return; all else its own."""

    def __init__(
        self, inner: Any, watch: Stopwatch, phases: Mapping[str, str], *returning: str
    ) -> None:
        self._inner = inner
        for method, phase in phases.items():
            if hasattr(inner, method):
                setattr(self, method, watch.timed(phase, getattr(inner, method)))
        self._again = lambda found: _Timed(found, watch, phases, *returning)
        for method in returning:
            if hasattr(inner, method):
                setattr(self, method, self._wrapped(getattr(inner, method)))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def _wrapped(self, work: Callable[..., Any]) -> Callable[..., Any]:
        """Return a method whose result is timed; what returns itself returns this."""

        def run(*arguments: Any) -> Any:
            found = work(*(x._inner if isinstance(x, _Timed) else x for x in arguments))
            return self if found is self._inner else self._again(found)

        return run


def attach(core: ScanCore, watch: Stopwatch) -> None:
    """Have the parts of a core timed, from now on."""
    timed: Any = _Timed  # it stands for a part of any kind
    truths = {"judge": "truth", "judge_alike": "truth", "wrench": "contact"}
    phantom = timed(core.phantom, watch, truths, "scene", "at")
    own = core.forces is core.phantom
    core.forces = phantom if own else timed(core.forces, watch, {"wrench": "contact"})
    core.phantom = phantom
    core.images = timed(core.images, watch, {"generate": "render"}, "of")
    if core.grader is not None:
        core.grader = timed(core.grader, watch, {"probabilities_and_grade": "grade"})
    core._reward = watch.timed("reward", core._reward)


def step_speed(config: SpeedConfig, phantom: WorldLike = None) -> dict[str, Any]:
    """Time random agents in the Gymnasium vector environment, at each batch size.

    Returns:
        What `racines study speed --json` prints: a run a batch size with `steps_per_second` (median
        of the rounds, all rows counted), its least and greatest round, `shares` of the time by
        phase, and the longest `operations` with their shares.
    """
    config = on_device(config)
    settings: dict[str, Any] = {
        name: getattr(config, name)
        for name in ("observation", "reward", "backend", "generator", "grader", "device")
    }
    envs = (VectorScanEnv(config.view, n, phantom=phantom, **settings) for n in config.num_envs)
    runs = [_time(env, config) for env in envs]
    device = torch.device(config.device)
    machine = {
        "device": torch.cuda.get_device_name(device) if device.type == "cuda" else "cpu",
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
        "torch": torch.__version__,
    }
    timed = {"steps": config.steps, "rounds": config.rounds, "machine": machine, "runs": runs}
    return {"schema": SCHEMA, "view": config.view, **settings, **timed}


def _time(env: VectorScanEnv, config: SpeedConfig) -> dict[str, Any]:
    watch = Stopwatch(env.core.device)
    rounds = [_round(env, config.steps, seed, watch) for seed in range(config.rounds)]
    speeds = [config.steps * env.num_envs / seconds for seconds in rounds]
    told = {"num_envs": env.num_envs, "steps_per_second": statistics.median(speeds)}
    told |= {"low": min(speeds), "high": max(speeds)}
    operations = _operations(env, config.operations) if config.operations else []
    attach(env.core, watch)
    whole = _round(env, config.steps, 0, watch)
    phases = watch.seconds
    phases["rest"] = whole - sum(phases.values())
    shares = {phase: seconds / whole for phase, seconds in phases.items()}
    return told | {"shares": shares, "operations": operations}


def _round(env: VectorScanEnv, steps: int, seed: int, watch: Stopwatch) -> float:
    """Return the seconds of so many random steps from a fresh start; resets are not timed."""
    size = (WARM_UP + steps, env.num_envs)
    actions = np.random.default_rng(seed).integers(len(ACTIONS), size=size)
    env.reset(seed=seed)
    for action in actions[:WARM_UP]:
        env.step(action)
    watch.seconds.update(dict.fromkeys(PHASES, 0.0))
    began = watch.now()
    for action in actions[WARM_UP:]:
        env.step(action)
    return watch.now() - began


def _operations(env: VectorScanEnv, count: int) -> list[dict[str, Any]]:
    """Return the operations that three steps spend most time in, by their own time."""
    from torch.profiler import ProfilerActivity, profile

    accelerated = env.core.device.type == "cuda"
    kinds = [ProfilerActivity.CPU, *([ProfilerActivity.CUDA] if accelerated else [])]
    own = "self_device_time_total" if accelerated else "self_cpu_time_total"
    times: dict[str, float] = {}
    env.reset(seed=0)
    for _ in range(2):  # the profiler's own start falls into the first
        with profile(activities=kinds) as told:
            for _ in range(3):
                env.step(np.zeros(env.num_envs, dtype=np.int64))
        times = {event.key: getattr(event, own) for event in told.key_averages()}
    whole = sum(times.values())
    longest = sorted(times, key=lambda name: -times[name])[:count]
    return [{"name": name, "share": times[name] / whole} for name in longest]
