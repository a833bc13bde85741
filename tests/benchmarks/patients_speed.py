"""What frames and steps of patients cost beside the one heart's, and what a heart takes.

OMP_NUM_THREADS=2 python -m tests.benchmarks.patients_speed docs/results/patients-speed.json

Two minutes. All sides take turns, so that what another process takes meets them alike; of the turns
the fastest counts.
"""

import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import gymnasium
import torch

from racines_data.files import write_json
from racines_data.geometry import Pose
from racines_data.patients import Pool, draw_patient
from racines_data.patients.bake import bake
from racines_data.patients.heart import make_heart
from racines_data.patients.volume import HEART_BYTES
from racines_data.phantom import shared_phantom

BATCH, HEARTS, TURNS = 64, 16, 7
STEPS = {"image": 5, "params": 40}
"""Steps of a turn, by what is observed."""
TASKS = {"one heart": "SC-v0", "patients": "SC-patients-v0", "beating": "SC-beating-v0"}


def fastest(sides: Mapping[str, Callable[[], object]]) -> dict[str, float]:
    """Return the least time of some turns of each side, s."""
    for work in sides.values():
        work()
    times: dict[str, list[float]] = {name: [] for name in sides}
    for _ in range(TURNS):
        for name, work in sides.items():
            start = time.perf_counter()
            work()
            times[name].append(time.perf_counter() - start)
    return {name: min(each) for name, each in times.items()}


def once(work: Callable[[], object]) -> float:
    """Return the time of one turn, s."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def at_targets(pool: Pool, rows: torch.Tensor) -> Pose:
    """Return poses of the views in turn."""
    every, each = pool.targets(rows), torch.arange(BATCH)
    return Pose(every.position[each, each % 5], every.rotation[each, each % 5])


def frames() -> dict[str, float]:
    """Return frames a second, by what is drawn."""
    pool = Pool(range(10_000, 10_000 + HEARTS), beating=True)
    seeds, one = torch.arange(BATCH), torch.zeros(BATCH, dtype=torch.int64)
    mixed = torch.arange(BATCH) % HEARTS
    phase = torch.rand((BATCH, 2), generator=torch.Generator().manual_seed(0)).double()
    phantom = shared_phantom()
    target = phantom.target("A4C")
    same = Pose(target.position.repeat(BATCH, 1), target.rotation.repeat(BATCH, 1, 1))
    first, poses = at_targets(pool, one), at_targets(pool, mixed)
    sides = {
        "phantom": lambda: phantom.render(same, seeds),
        "one": lambda: pool.render(first, one, None, seeds),
        "mixed": lambda: pool.render(poses, mixed, None, seeds),
        "beating": lambda: pool.render(poses, mixed, phase, seeds),
        "masked": lambda: (
            pool.render(poses, mixed, phase, seeds),
            pool.mask(poses, mixed, phase),
        ),
        "judged": lambda: pool.judge(poses, mixed, phase),
    }
    return {name: BATCH / seconds for name, seconds in fastest(sides).items()}


def steps(observation: str) -> dict[str, float]:
    """Return steps a second of 64 rows with the oracle's reward, by whose heart is scanned."""
    envs = {name: make(task, observation) for name, task in TASKS.items()}
    g = torch.Generator().manual_seed(0)
    actions = torch.randint(0, 12, (STEPS[observation], BATCH), generator=g).numpy()

    def play(env: gymnasium.vector.VectorEnv[Any, Any, Any]) -> None:
        env.reset(seed=list(range(BATCH)))
        for action in actions:
            env.step(action)

    for env in envs.values():
        env.reset(seed=0)
    starts = {
        name: lambda env=env: env.reset(seed=list(range(BATCH))) for name, env in envs.items()
    }
    plays = {name: lambda env=env: play(env) for name, env in envs.items()}
    resets, whole = fastest(starts), fastest(plays)
    for env in envs.values():
        env.close()
    return {name: len(actions) * BATCH / (whole[name] - resets[name]) for name in envs}


def make(task: str, observation: str) -> gymnasium.vector.VectorEnv[Any, Any, Any]:
    """Return 64 rows of a task; patients are those of the pool whose frames are drawn."""
    whose = {} if task == TASKS["one heart"] else {"split": "validation", "patients": HEARTS}
    return gymnasium.make_vec(
        f"racines_envs:racines/{task}", num_envs=BATCH, observation=observation, reward="oracle",
        **whose,
    )  # fmt: skip


def main(out: Path | None) -> None:
    """Print what was measured, and write it if it is said where."""
    figures: dict[str, float] = {
        "bake_seconds": round(once(lambda: bake(draw_patient(10_500))), 2),
        "nominal_seconds": round(once(lambda: make_heart(draw_patient(10_501), True)), 2),
        "heart_megabytes": round(HEART_BYTES / 1e6, 1),
    }
    drawn = frames()
    told = ("phantom", "one", "judged")
    figures |= {f"{name}_frames": round(drawn[name]) for name in told}
    ratios = {"mixed_to_one": ("mixed", "one"), "beating_to_mixed": ("beating", "mixed")}
    ratios |= {"masked_to_beating": ("masked", "beating"), "one_to_phantom": ("one", "phantom")}
    figures |= {name: round(drawn[b] / drawn[a], 2) for name, (a, b) in ratios.items()}
    for observation in STEPS:
        rates = steps(observation)
        for name, rate in rates.items():
            key = f"{observation}_steps_{name.replace(' ', '_')}"
            figures[key] = round(rate)
            if name != "one heart":
                figures[f"{key}_share"] = round(rate / rates["one heart"], 2)
    for name, value in figures.items():
        print(f"{name:32} {value:,}")
    if out:
        write_json(out, {
            "schema": "racines.figures/1",
            "what": "frames and steps of patients a second, and ratios",
            "command": f"OMP_NUM_THREADS=2 python -m tests.benchmarks.patients_speed {out}",
            "machine": "two CPU cores",
            "source": "measured once",
            "figures": figures,
        })  # fmt: skip


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
