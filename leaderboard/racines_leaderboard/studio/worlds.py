"""Tasks that the pages offer, and where one plays: in the dataset's phantom, or in a patient."""

from dataclasses import dataclass
from functools import cache
from typing import Any

from racines_data.patients.splits import SPLITS, split_of
from racines_data.views import VIEWS
from racines_envs.evaluation.patients import StartSet
from racines_envs.robots.arm import FREE
from racines_envs.task.names import BEATING, HEART_TIER, PATIENTS, task_name, tier_of
from racines_envs.task.starts import evaluation_seeds
from racines_envs.task.tasks import TASKS, Task, get_task
from racines_envs.worlds.making import make_core
from racines_envs.worlds.ward import Ward, make_ward
from racines_leaderboard.studio import inputs
from racines_leaderboard.studio.parts import Place, Shared, load_grader, load_phantom

FIXED, SEEDED = "evaluation", "seed"
KINDS = (FIXED, SEEDED)
"""How a start is named: by its number among the fixed starts of evaluations, or by a seed."""
FIXED_STARTS = 100
FIRST_PATIENT = SPLITS["validation"][0]
"""Whom a page shows first: nobody of the test split."""
PATIENTS_OFFERED = "; ".join(f"{name} {seeds[0]} to {seeds[-1]}" for name, seeds in SPLITS.items())
_wards: Shared[Ward] = Shared(6)


@dataclass(frozen=True)
class Start:
    """A task and one of its starts; `patient` is 0 in the one heart."""

    task: str
    kind: str
    number: int
    robot: str = FREE
    patient: int = 0


@cache
def tasks() -> dict[str, Task]:
    """Return the tasks that are offered, by name: those of the one heart first."""
    names = (task_name(view, tier=tier) for tier in (PATIENTS, BEATING) for view in VIEWS)
    return dict(TASKS) | {name: get_task(name) for name in names}


def on_patients(task: str) -> bool:
    """Tell whether a task scans patients."""
    return tier_of(task) != HEART_TIER


def patient_of(value: Any) -> int:
    """Return a patient's seed that a browser sent; a `RacinesError` for one of no split."""
    seed = inputs.whole(value, 1, max(seeds[-1] for seeds in SPLITS.values()), "patient")
    split_of(seed)
    return seed


def start_of(
    task: Any, kind: Any, number: Any, robot: Any, patient: Any, robots: tuple[str, ...]
) -> Start:
    """Return what a browser sent as a start; raise a `RacinesError` for what was not offered."""
    robot = inputs.choice(robot, robots, "robot")
    task, kind = inputs.choice(task, tuple(tasks()), "task"), inputs.choice(kind, KINDS, "start")
    greatest = FIXED_STARTS - 1 if kind == FIXED else inputs.GREATEST_SEED
    number = inputs.whole(number, 0, greatest, "number of the start")
    return Start(task, kind, number, robot, patient_of(patient) if on_patients(task) else 0)


def ward_of(place: Place, tier: str, patient: int) -> Ward:
    """Return the ward of one patient; its voxels are baked when the first image is drawn."""
    key = tier, patient, place.device
    return _wards.get(key, lambda: make_ward(tier, split_of(patient), (patient,), place.device))


def core_and_grader(
    place: Place, start: Start, observation: str, encoder: Any = None
) -> tuple[Any, Any]:
    """Return a task's core of one row, rewarded by the truth, and the grader of its images."""
    task = tasks()[start.task]
    if start.patient:
        world: Any = ward_of(place, tier_of(start.task), start.patient)
    else:
        world = load_phantom(place, task.anatomy)
    core = make_core(
        task, observation=observation, reward="oracle", device=place.device, phantom=world,
        encoder=encoder, robot=start.robot,
    )  # fmt: skip
    tier = "phantom-patients" if start.patient else ""
    return core, load_grader(place, core.phantom.labels, tier)


def reset(core: Any, start: Start) -> Any:
    """Begin an episode of a core of one row; return the first observation."""
    if not start.patient:
        fixed = start.kind == FIXED
        return core.reset(evaluation_seeds(start.number + 1)[-1:] if fixed else start.number)
    case = core.phantom.case_of([start.patient])
    if start.kind == SEEDED:
        return core.reset(start.number, case=case)
    return core.reset(StartSet((start.patient,), start.number + 1, 0).seeds[-1:], case=case)
