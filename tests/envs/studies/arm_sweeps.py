"""Whether an arm can follow simulated sweeps of full length, drawn for a free probe and for it.

python -m tests.envs.studies.arm_sweeps      # writes docs/results/arm-sweeps.json
"""

from dataclasses import replace
from pathlib import Path

import torch

from racines_data.files import write_json
from racines_data.geometry import Pose, parameters_to_pose
from racines_data.patients import Pool
from racines_data.patients.splits import seeds_of
from racines_data.phantom.acquisition import AcquisitionConfig, make_sweep
from racines_data.phantom.model import shared_phantom
from racines_data.phantom.pacing import FREE
from racines_data.randomness import derive, sample_seeds
from racines_data.sources.patients import SWEEPS, PatientsSource
from racines_data.sources.phantom import PhantomSource
from racines_data.views import VIEWS
from racines_envs.robots.following import angles, hurry
from racines_envs.robots.ur5e import UR5E
from racines_models.provenance import environment

RESULT = Path(__file__).parents[3] / "docs/results/arm-sweeps.json"
PATIENTS, LOOKED_AT = 10, 40
"""Validation patients who are scanned, and whose views' nominal poses are looked at."""
FULL = AcquisitionConfig(frames=6000, shortest=90, longest=150)


def missed_percent(hurries: torch.Tensor) -> float:
    """Return how many of a hundred moves the arm cannot make."""
    return round(100.0 * float((~(hurries <= 1.0)).double().mean()), 1)


def hurries(config: AcquisitionConfig) -> torch.Tensor:
    """Return of every move from frame to frame the share of the joints' speed that it takes."""
    found, phantom = [], shared_phantom(config.phantom)
    for unit in PhantomSource(config).plan():
        seed = derive(sample_seeds(config.seed, 1), unit.index, 1)
        session = int(unit.session.rpartition("-")[2]) - 1
        sweep = make_sweep(phantom, config, unit.target_view, session, unit.frames, seed)
        found.append(hurry(UR5E.name, sweep.pose, config.rate))
    return torch.cat(found)


def hurries_of_patients(robot: str) -> torch.Tensor:
    """Return the same of sweeps over validation patients, of the poses as they were measured."""
    settings = {"validation": PATIENTS, "frames_per_sweep": 40, "masks": False, "robot": robot}
    source, found = PatientsSource.from_config(settings), []
    for unit in source.plan():
        pose = parameters_to_pose(torch.from_numpy(source.produce(unit).parameters).double())
        found.append(hurry(UR5E.name, pose, SWEEPS.rate))
    return torch.cat(found)


def out_of_reach() -> int:
    """Return how many nominal poses of the five views the arm cannot take, of `LOOKED_AT`."""
    count, row = 0, torch.zeros(1, dtype=torch.int64)
    for seed in seeds_of("validation")[:LOOKED_AT]:
        nominal = Pose(*(part[0] for part in Pool([seed]).targets(row)))
        count += int((~angles(UR5E.name, nominal).isfinite().all(1)).sum())
    return count


def main() -> None:
    """Measure, and write."""
    free, arm = hurries(FULL), hurries(replace(FULL, robot=UR5E.name))
    apart, theirs = hurries_of_patients(FREE), hurries_of_patients(UR5E.name)
    write_json(RESULT, {
        "schema": "racines.figures/1",
        "what": "moves of simulated sweeps that a UR5e cannot follow, of 90 to 150 frames over the "
        f"one heart and of 40 over {PATIENTS} validation patients",
        "command": "python -m tests.envs.studies.arm_sweeps",
        "machine": f"{environment('cpu')['cpu']}, one thread",
        "source": "measured once",
        "figures": {
            "moves": len(free),
            "free_missed_percent": missed_percent(free),
            "arm_missed": int((~(arm <= 1.0)).sum()),
            "fastest_percent": round(100.0 * float(arm.max())),
            "views": LOOKED_AT * len(VIEWS),
            "views_out_of_reach": out_of_reach(),
            "patients": PATIENTS,
            "patient_moves": len(apart),
            "patient_free_missed_percent": missed_percent(apart),
            "patient_arm_missed": int((~(theirs <= 1.0)).sum()),
            "patient_fastest_percent": round(100.0 * float(theirs.max())),
        },
    })  # fmt: skip


if __name__ == "__main__":
    main()
