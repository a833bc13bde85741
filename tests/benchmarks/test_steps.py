"""Speed of the environments: steps a second of 64 rows, beside two peers in the same run.

Ours is `gymnasium.make_vec`, one batched core. The peers are Gymnasium's `SyncVectorEnv` and
`AsyncVectorEnv` (shared memory, one thread a process) of 64 single environments each. All take the
same actions from the same seeds in turns, a round each, and every observation, reward and flag has
to be equal. Only the steps are timed; a ratio is the median of the rounds, the first left out.

With a grader in the loop observations and flags are equal, rewards to a grade's rounding: a
convolution may round differently in other batches. The student is untrained, of the default
configuration, since weights do not change its speed.
"""

import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv

from racines_data.phantom import shared_phantom
from racines_envs.task.actions import ACTIONS
from racines_envs.worlds.backends import make_grader
from racines_models.judges.student.model import Student, StudentConfig
from tests.benchmarks.lines import line_of
from tests.benchmarks.turns import Times, in_turns
from tests.conftest import ROOT

ENVS = 64
ROUNDS = 5
TASK = "racines_envs:racines/SC-v0"
STEPS = {"image": 5, "params": 12}
TARGETS = {"image": {"sync": 3.0, "async": 2.0}, "params": {"sync": 30.0, "async": 10.0}}
PEERS = {"sync": "SyncVectorEnv", "async": "AsyncVectorEnv, a process each"}
NAMES = {"student": "student", "resnet18": "ResNet-18"}
EVERY = "every observation, reward and flag"
HEART = "the one heart"
TIERS = {HEART: "SC-v0", "patients": "SC-patients-v0", "beating hearts": "SC-beating-v0"}
GRADED = {"student": 500.0, "resnet18": 150.0}
"""Least steps a second with a grader, on two cores."""


@pytest.mark.timeout(900)
@pytest.mark.slow
@pytest.mark.parametrize("observation", TARGETS)
def test_64_rows_in_one_core(benchmark, line, observation: str) -> None:
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
    rates = {name: rate(each, STEPS[observation]) for name, each in seconds.items()}
    report(benchmark, observation, steps_per_second=rates)
    work = f"steps of 64 environments, {observation}, no grader"
    items = STEPS[observation] * ENVS
    for name, least in TARGETS[observation].items():
        times = {"ours": seconds["ours"], PEERS[name]: seconds[name]}
        one = line_of(work, "steps/s", items, times, PEERS[name], EVERY, least)
        line(one)
        assert one.ratio >= least, one


@pytest.mark.timeout(300)
@pytest.mark.slow
@pytest.mark.parametrize("observation", TARGETS)
def test_patients_beside_one_heart(benchmark, line, observation: str) -> None:
    """What hearts that nobody trained on cost, still and beating: ours against ours."""
    settings = {"observation": observation, "reward": "oracle"}
    sides = {name: gymnasium.make_vec(f"racines_envs:racines/{task}", num_envs=ENVS, **settings)
             for name, task in TIERS.items()}  # fmt: skip
    steps = 4 * STEPS[observation]
    try:
        times = in_turns(
            {name: partial(play, env, steps, 0) for name, env in sides.items()}, ROUNDS
        )
        benchmark.pedantic(lambda: play(sides["patients"], steps, 0), rounds=2)
    finally:
        for env in sides.values():
            env.close()
    work = f"steps of 64 environments, {observation}, {{}}"
    for name in ("patients", "beating hearts"):
        told = line_of(
            work.format(name), "steps/s", steps * ENVS, times, HEART, "actions", ours=name
        )
        line(told)


@pytest.mark.timeout(300)
@pytest.mark.slow
@pytest.mark.parametrize("name", GRADED)
def test_64_rows_with_a_grader(benchmark, line, name: str) -> None:
    """The peer is a `SyncVectorEnv` whose single environments share the grader."""
    grader = untrained_student() if name == "student" else ROOT / "models/weights/grader"
    grader = make_grader(grader, "cpu")
    env = gymnasium.make_vec(TASK, num_envs=ENVS, grader=grader)
    single = SyncVectorEnv([partial(gymnasium.make, TASK, grader=grader)] * ENVS)
    seconds: Times = {"ours": [], PEERS["sync"]: []}
    for turn in range(4):
        (took, mine), (peer, theirs) = (play(each, 2, turn) for each in (env, single))
        assert_equal(mine, theirs, parts=(0, 2, 3))
        for one, other in zip(mine, theirs, strict=True):
            assert np.allclose(one[1], other[1], atol=0.5), "grades are of bfloat16"
        if turn:
            seconds["ours"].append(took)
            seconds[PEERS["sync"]].append(peer)
    benchmark.pedantic(lambda: play(env, STEPS["image"], 0), rounds=ROUNDS)
    work = f"steps of 64 environments, image, graded by the {NAMES[name]}"
    equal = "observations, flags; rewards within a grade's rounding"
    one = line_of(work, "steps/s", 2 * ENVS, seconds, PEERS["sync"], equal)
    line(one)
    assert one.ours >= GRADED[name], one


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


def assert_equal(ours: list[tuple], peers: list[tuple], parts: tuple = (0, 1, 2, 3)) -> None:
    for mine, theirs in zip(ours, peers, strict=True):
        for part, other in ((mine[i], theirs[i]) for i in parts):
            assert part.dtype == other.dtype and np.array_equal(part, other)


def rate(seconds: list[float], steps: int) -> float:
    return steps * ENVS / statistics.median(seconds)


def report(benchmark: Callable, what: str, **figures: Any) -> None:
    print(what, f"{torch.get_num_threads()} threads", figures)
    benchmark.extra_info.update(figures)  # type: ignore[attr-defined]
