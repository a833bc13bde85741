"""What a frame of a patient costs, and what a heart takes, in one run.

OMP_NUM_THREADS=2 python -m tests.benchmarks.patients_speed      # minutes
"""

import time
from collections.abc import Callable

import torch

from racines_data.geometry import Pose
from racines_data.patients import Pool, draw_patient
from racines_data.patients.bake import bake
from racines_data.patients.heart import make_heart
from racines_data.patients.volume import HEART_BYTES
from racines_data.phantom import shared_phantom

BATCH, HEARTS, TURNS = 64, 16, 7


def best(work: Callable[[], object]) -> float:
    """Return the least of some turns, ms: what another process takes is not counted."""
    work()
    times: list[float] = []
    for _ in range(TURNS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return 1e3 * min(times)


def at_targets(pool: Pool, rows: torch.Tensor) -> Pose:
    """Return poses of the views in turn."""
    every, each = pool.targets(rows), torch.arange(BATCH)
    return Pose(every.position[each, each % 5], every.rotation[each, each % 5])


def main() -> None:
    """Print the table."""
    start = time.perf_counter()
    bake(draw_patient(10_500))
    baking = time.perf_counter() - start
    start = time.perf_counter()
    make_heart(draw_patient(10_501), True)
    searching = time.perf_counter() - start
    pool = Pool(range(10_000, 10_000 + HEARTS), beating=True)
    seeds, one = torch.arange(BATCH), torch.zeros(BATCH, dtype=torch.int64)
    mixed = torch.arange(BATCH) % HEARTS
    phase = torch.rand((BATCH, 2), generator=torch.Generator().manual_seed(0)).double()
    phantom = shared_phantom()
    target = phantom.target("A4C")
    same = Pose(target.position.repeat(BATCH, 1), target.rotation.repeat(BATCH, 1, 1))
    first, poses = at_targets(pool, one), at_targets(pool, mixed)
    rows = {
        "phantom, one heart": lambda: phantom.render(same, seeds),
        "pool, one heart, still": lambda: pool.render(first, one, None, seeds),
        f"pool, {HEARTS} hearts, still": lambda: pool.render(poses, mixed, None, seeds),
        f"pool, {HEARTS} hearts, beating": lambda: pool.render(poses, mixed, phase, seeds),
        "the same with mask": lambda: (
            pool.render(poses, mixed, phase, seeds),
            pool.mask(poses, mixed, phase),
        ),
        "judged": lambda: pool.judge(poses, mixed, phase),
    }
    for name, work in rows.items():
        spent = best(work) / BATCH
        print(f"{name:32} {spent:7.3f} ms a frame {1e3 / spent:9.0f} a second")
    print(f"bake {baking:.1f} s, nominal poses {searching:.2f} s, {HEART_BYTES:,} bytes a heart")
    print(f"{torch.get_num_threads()} threads")


if __name__ == "__main__":
    main()
