"""Speed of the environments: steps a second of 64 rows, beside two peers in the same run.

Ours is `gymnasium.make_vec`, one batched core. The peers are Gymnasium's `SyncVectorEnv` and
`AsyncVectorEnv` (shared memory, one thread a process) of 64 single environments each. All take the
same actions from the same seeds in turns, a round each, and every observation, reward and flag has
to be equal. Only the steps are timed; a ratio is the median of the rounds, the first left out.

With a grader in the loop observations and flags are equal, rewards to a grade's rounding: a
convolution may round differently in other batches. The single environments of one process share a
grader, each process of its own loads one. The student is untrained, of the default configuration,
since weights do not change its speed.

Compiled steps stand beside the same rows that are not compiled, equal to a rounding.

Patients stand beside the one heart, ours beside ours. That each row of theirs is the single
environment of its seed, bit by bit, is asserted before they are timed.
"""

import statistics
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
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
TASK = "racines_envs:racines/{}"
STEPS = {"image": 5, "params": 12}
TARGETS = {"image": {"sync": 3.0, "async": 2.0}, "params": {"sync": 30.0, "async": 10.0}}
PEERS = {"sync": "SyncVectorEnv", "async": "AsyncVectorEnv, a process each"}
NAMES = {"student": "student", "resnet18": "ResNet-18"}
EVERY = "every observation, reward and flag"
ROWS = "actions; rows give every observation, reward and flag of single environments"
GRADES = "observations, flags; rewards within a grade's rounding"
HEART = "the one heart"
TIERS = {HEART: "SC-v0", "patients": "SC-patients-v0", "beating hearts": "SC-beating-v0"}
BESIDE = ("patients", "beating hearts")
COMPILED = (HEART, "patients")
COMPILED_WORK = "compiled steps of 64 environments, params, {}"
UNCOMPILED = "the same, not compiled"
FLAGS = "flags; observations and rewards within 1e-4"
GRADED = {"student": 500.0, "resnet18": 150.0}
"""Least steps a second with a grader, on two cores."""


@pytest.mark.timeout(900)
@pytest.mark.slow
@pytest.mark.parametrize("observation", TARGETS)
def test_64_rows_in_one_core(benchmark, line, observation: str) -> None:
    envs = make_sides(observation=observation, reward="oracle")
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


@pytest.mark.timeout(600)
@pytest.mark.slow
@pytest.mark.parametrize("name", COMPILED)
def test_compiled_steps(benchmark, line, name: str) -> None:
    """Steps by the pose with `compile=True`, beside the same rows without, and single ones."""
    task, settings = TIERS[name], {"observation": "params", "reward": "oracle"}
    ours, plain = rows_of(task, **settings, compile=True), rows_of(task, **settings)
    single = single_rows(task, **settings)
    steps = 5 * STEPS["params"]
    sides = {"ours": (ours, steps), UNCOMPILED: (plain, steps), PEERS["sync"]: (single, 6)}
    try:
        told = {side: play(env, 2, 1)[1] for side, (env, _) in sides.items()}
        for side in told:
            assert_equal_but_for_float32(told["ours"], told[side])
        times: Times = {side: [] for side in sides}
        for _ in range(ROUNDS):
            for side, (env, count) in sides.items():  # seconds of so many steps, resets left out
                times[side].append(play(env, count, 0)[0] * steps / count)
        benchmark.pedantic(lambda: play(ours, steps, 0), rounds=ROUNDS)
    finally:
        for env, _ in sides.values():
            env.close()
    work = COMPILED_WORK.format("no grader" if name == HEART else name)
    for peer in (UNCOMPILED, PEERS["sync"]):
        line(line_of(work, "steps/s", steps * ENVS, times, peer, FLAGS))


@pytest.mark.timeout(300)
@pytest.mark.slow
@pytest.mark.parametrize("observation", TARGETS)
def test_patients_beside_one_heart(benchmark, line, observation: str) -> None:
    """What hearts that nobody trained on cost, still and beating: ours against ours."""
    settings = {"observation": observation, "reward": "oracle"}
    sides = {name: rows_of(task, **settings) for name, task in TIERS.items()}
    steps = 4 * STEPS[observation]
    try:
        for name in BESIDE:
            assert_rows_are_single(sides[name], TIERS[name], **settings)
        times = in_turns(
            {name: partial(play, env, steps, 0) for name, env in sides.items()}, ROUNDS
        )
        benchmark.pedantic(lambda: play(sides["patients"], steps, 0), rounds=2)
    finally:
        for env in sides.values():
            env.close()
    work = f"steps of 64 environments, {observation}, {{}}"
    for name in BESIDE:
        line(line_of(work.format(name), "steps/s", steps * ENVS, times, HEART, ROWS, ours=name))


@pytest.mark.timeout(900)
@pytest.mark.slow
@pytest.mark.parametrize("name", GRADED)
def test_64_rows_with_a_grader(benchmark, line, name: str, tmp_path: Path) -> None:
    envs = make_sides(grader_folder(name, tmp_path))
    seconds: dict[str, list[float]] = {side: [] for side in envs}
    try:
        for turn in range(4):
            told = {side: play(env, 2, turn) for side, env in envs.items()}
            for side, (took, seen) in told.items():
                assert_equal_but_for_rounding(told["ours"][1], seen)
                if turn:
                    seconds[side].append(took)
        benchmark.pedantic(lambda: play(envs["ours"], STEPS["image"], 0), rounds=ROUNDS)
    finally:
        for env in envs.values():
            env.close()
    work = f"steps of 64 environments, image, graded by the {NAMES[name]}"
    for side, peer in PEERS.items():
        times = {"ours": seconds["ours"], peer: seconds[side]}
        one = line_of(work, "steps/s", 2 * ENVS, times, peer, GRADES)
        line(one)
        assert one.ours >= GRADED[name], one


def make_sides(grader: Path | None = None, **settings: Any) -> dict[str, Any]:
    """Return our vector environment and its peers; the phantom is baked before they fork."""
    shared_phantom()
    task = TASK.format(TIERS[HEART])

    def alone() -> gymnasium.Env:
        torch.set_num_threads(1)
        return gymnasium.make(task, **settings, **({"grader": grader} if grader else {}))

    threads = torch.get_num_threads()
    processes = AsyncVectorEnv([alone] * ENVS, shared_memory=True, context="fork")
    torch.set_num_threads(threads)  # one was made in this process, to read its spaces
    if grader:
        settings |= {"grader": make_grader(grader, "cpu")}
    ours, single = rows_of(TIERS[HEART], **settings), single_rows(TIERS[HEART], **settings)
    return {"ours": ours, "sync": single, "async": processes}


def rows_of(task: str, **settings: Any) -> Any:
    """Return all rows of a task in one batched core."""
    return gymnasium.make_vec(TASK.format(task), num_envs=ENVS, **settings)


def single_rows(task: str, **settings: Any) -> Any:
    """Return as many single environments, one after the other."""
    return SyncVectorEnv([partial(gymnasium.make, TASK.format(task), **settings)] * ENVS)


def assert_rows_are_single(env: Any, task: str, **settings: Any) -> None:
    """Check that the rows of a batch are the single environments of their seeds, bit by bit."""
    peers = single_rows(task, **settings)
    try:
        assert_equal(play(env, 3, 1)[1], play(peers, 3, 1)[1])
    finally:
        peers.close()


def grader_folder(name: str, folder: Path) -> Path:
    """Return the folder of a grader; an untrained student's weights are written to one."""
    if name != "student":
        return ROOT / "models/weights/grader"
    untrained_student().save(folder)
    return folder


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


def assert_equal_but_for_rounding(ours: list[tuple], peers: list[tuple]) -> None:
    """Check that steps are equal, rewards as far as grades of bfloat16 tell."""
    assert_equal(ours, peers, parts=(0, 2, 3))
    for one, other in zip(ours, peers, strict=True):
        assert np.allclose(one[1], other[1], atol=0.5), "grades are of bfloat16"


def assert_equal_but_for_float32(ours: list[tuple], peers: list[tuple]) -> None:
    """Check that steps are equal, numbers as far as code that was compiled rounds alike."""
    assert_equal(ours, peers, parts=(2, 3))
    for one, other in zip(ours, peers, strict=True):
        assert all(np.allclose(one[k], other[k], rtol=0.0, atol=1e-4) for k in (0, 1))


def rate(seconds: list[float], steps: int) -> float:
    return steps * ENVS / statistics.median(seconds)


def report(benchmark: Callable, what: str, **figures: Any) -> None:
    print(what, f"{torch.get_num_threads()} threads", figures)
    benchmark.extra_info.update(figures)  # type: ignore[attr-defined]
