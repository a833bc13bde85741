"""Whether an arm can follow simulated sweeps of full length, drawn for a free probe and for it.

python -m tests.envs.studies.arm_sweeps      # writes docs/results/arm-sweeps.json
"""

from dataclasses import replace
from pathlib import Path

import torch

from racines_data.files import write_json
from racines_data.phantom.acquisition import AcquisitionConfig, make_sweep
from racines_data.phantom.model import shared_phantom
from racines_data.randomness import derive, sample_seeds
from racines_data.sources.phantom import PhantomSource
from racines_envs.robots.following import hurry
from racines_envs.robots.ur5e import UR5E

RESULT = Path(__file__).parents[3] / "docs/results/arm-sweeps.json"
FULL = AcquisitionConfig(frames=6000, shortest=90, longest=150)


def hurries(config: AcquisitionConfig) -> torch.Tensor:
    """Return of every move from frame to frame the share of the joints' speed that it takes."""
    found, phantom = [], shared_phantom(config.phantom)
    for unit in PhantomSource(config).plan():
        seed = derive(sample_seeds(config.seed, 1), unit.index, 1)
        session = int(unit.session.rpartition("-")[2]) - 1
        sweep = make_sweep(phantom, config, unit.target_view, session, unit.frames, seed)
        found.append(hurry(UR5E.name, sweep.pose, config.rate))
    return torch.cat(found)


def main() -> None:
    """Measure, and write."""
    free, arm = hurries(FULL), hurries(replace(FULL, robot=UR5E.name))
    write_json(RESULT, {
        "schema": "racines.figures/1",
        "what": "moves of simulated sweeps of 90 to 150 frames that a UR5e cannot follow",
        "command": "python -m tests.envs.studies.arm_sweeps",
        "machine": "one core of an AMD EPYC (Zen 4)",
        "source": "measured once",
        "figures": {
            "moves": len(free),
            "free_missed_percent": round(100.0 * float((~(free <= 1.0)).double().mean()), 1),
            "arm_missed": int((~(arm <= 1.0)).sum()),
            "fastest_percent": round(100.0 * float(arm.max())),
        },
    })  # fmt: skip


if __name__ == "__main__":
    main()
