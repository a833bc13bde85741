"""Speed of the environments: steps a second of 64 rows, beside two peers in the same run.

Ours is `gymnasium.make_vec`, one batched core. The peers are Gymnasium's `SyncVectorEnv` and
`AsyncVectorEnv` (shared memory, one thread a process) of 64 single environments each. All take the
same actions from the same seeds in turns, a round each, and every observation, reward and flag has
to be equal. Only the steps are timed; a ratio is the median of the rounds, the first left out.

With a grader in the loop no peer is timed: a convolution may round differently in other batches.
The student is untrained, of the default configuration, since weights do not change its speed.
"""

import statistics
import time
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv

from racines_data.phantom import shared_phantom
from racines_envs.task.actions import ACTIONS
from racines_models.judges.student.model import Student, StudentConfig
from tests.conftest import ROOT

ENVS = 64
ROUNDS = 5
TASK = "racines_envs:racines/SC-v0"
STEPS = {"image": 5, "params": 12}
TARGETS = {"image": {"sync": 3.0, "async": 2.0}, "params": {"sync": 30.0, "async": 10.0}}
GRADED = {"student": 500.0, "resnet18": 150.0}
"""Least steps a second with a grader, on two cores."""


@pytest.mark.timeout(900)
@pytest.mark.slow
@pytest.mark.parametrize("observation", TARGETS)
def test_64_rows_in_one_core(benchmark, observation: str) -> None:
    envs = make_sides(observation)
    seconds: dict[str, list[float]] = {name: [] for name in envs}
    try:
        for turn in range(ROUNDS + 1):
            told = {name: play(env, STEPS[observation], turn) for name, env in envs.items()}
            for name, (took, seen) in told.items():
                assert_equal(told["ours"][1], seen)
                if turn:  # the first warms up
                    seconds[name].append(took)
        benchmark.pedantic(lambda: play(envs["ours"], STEPS[observation], 0), rounds=ROUNDS)
    finally:
        for env in envs.values():
            env.close()
    ratios = {name: ratio(seconds[name], seconds["ours"]) for name in TARGETS[observation]}
    rates = {name: rate(each, STEPS[observation]) for name, each in seconds.items()}
    report(benchmark, observation, ratios=ratios, steps_per_second=rates)
    for name, least in TARGETS[observation].items():
        assert ratios[name] >= least, f"{observation}: {ratios[name]:.1f} times {name}"


@pytest.mark.timeout(300)
@pytest.mark.slow
@pytest.mark.parametrize("name", GRADED)
def test_64_rows_with_a_grader(benchmark, name: str) -> None:
    grader = untrained_student() if name == "student" else ROOT / "models/weights/grader"
    env = gymnasium.make_vec(TASK, num_envs=ENVS, grader=grader)
    steps = STEPS["image"]
    took = [play(env, steps, turn)[0] for turn in range(ROUNDS + 1)][1:]
    benchmark.pedantic(lambda: play(env, steps, 0), rounds=ROUNDS)
    report(benchmark, name, steps_per_second=rate(took, steps))
    assert rate(took, steps) >= GRADED[name]


def make_sides(observation: str) -> dict[str, Any]:
    """Return our vector environment and its peers; the phantom is baked before they fork."""
    shared_phantom()
    settings = {"observation": observation, "reward": "oracle"}

    def single() -> gymnasium.Env:
        return gymnasium.make(TASK, **settings)

    def alone() -> gymnasium.Env:
        torch.set_num_threads(1)
        return single()

    threads = torch.get_num_threads()
    processes = AsyncVectorEnv([alone] * ENVS, shared_memory=True, context="fork")
    torch.set_num_threads(threads)  # one was made in this process, to read its spaces
    ours = gymnasium.make_vec(TASK, num_envs=ENVS, **settings)
    return {"ours": ours, "sync": SyncVectorEnv([single] * ENVS), "async": processes}


def untrained_student() -> Student:
    return Student(Student.build(StudentConfig(), 6), StudentConfig())


def play(env: Any, steps: int, seed: int) -> tuple[float, list[tuple]]:
    """Take random steps from the starts of a seed; return their seconds and what they gave."""
    actions = np.random.default_rng(seed).integers(len(ACTIONS), size=(steps, ENVS))
    env.reset(seed=1000 * seed)
    start = time.perf_counter()
    told = [env.step(action)[:4] for action in actions]
    return time.perf_counter() - start, told


def assert_equal(ours: list[tuple], peers: list[tuple]) -> None:
    for mine, theirs in zip(ours, peers, strict=True):
        for part, other in zip(mine, theirs, strict=True):
            assert part.dtype == other.dtype and np.array_equal(part, other)


def ratio(peer: list[float], own: list[float]) -> float:
    return statistics.median(theirs / mine for theirs, mine in zip(peer, own, strict=True))


def rate(seconds: list[float], steps: int) -> float:
    return steps * ENVS / statistics.median(seconds)


def report(benchmark: Callable, what: str, **figures: Any) -> None:
    print(what, f"{torch.get_num_threads()} threads", figures)
    benchmark.extra_info.update(figures)  # type: ignore[attr-defined]
