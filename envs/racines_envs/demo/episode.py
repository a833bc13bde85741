"""Which patient, from which start, and what came of it."""

import secrets
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import Pose
from racines_data.patients.heart import Heart
from racines_data.patients.labels import LABELS as PARTS
from racines_data.patients.splits import check_split, seeds_of
from racines_data.randomness import derive, uniform
from racines_data.views import LABELS, VIEW_TITLES, VIEWS
from racines_envs.demo.watching import Shot, Watched, watch
from racines_envs.evaluation.patients import PatientsConfig, StartSet
from racines_envs.evaluation.run import core_for
from racines_envs.task.core import ScanCore
from racines_envs.task.names import HEART_TIER, TIERS
from racines_envs.task.tiers import STEP_SECONDS
from racines_envs.worlds.ward import Ward, make_ward
from racines_models.published.places import published

POLICY = Path("envs/weights/servo")
SPLIT = "test"
LARGEST = 1_000_000
"""Seeds that are drawn for oneself end below it."""
CHAMBERS = ("LV", "RV", "LA", "RA", "aorta")
"""What is named in the pictures of the end."""
_FEWEST = 60  # pixels of a part that is named
_WHO = 811  # random stream of the choice


@dataclass(frozen=True)
class Draw:
    """Who is scanned, how, and from where."""

    patient: int
    seed: int
    view: str = "A4C"
    tier: str = "beating"

    @property
    def again(self) -> str:
        """The command that repeats it."""
        words = f"racines demo --patient {self.patient} --seed {self.seed}"
        words += "" if self.view == "A4C" else f" --view {self.view}"
        return words + ("" if self.tier == "beating" else f" --tier {self.tier}")


@dataclass(frozen=True)
class Outcome:
    """An episode, and the truth about it."""

    draw: Draw
    shots: list[Shot]
    found: bool
    declared: bool
    heart: Heart
    own: Pose
    """The patient's own pose of the view, a batch of one."""
    own_image: np.ndarray
    """(128, 128) uint8, what the probe sees there."""
    names: tuple[dict[str, tuple[float, float]], dict[str, tuple[float, float]]]
    """Where parts of the heart lie in the last picture and in that one, shares of its sides."""
    seconds: float
    """That the agent was watched for."""

    @property
    def pixel(self) -> float:
        """The side of a picture's pixel, mm."""
        return float(self.heart.settings.pixel_size()[0])

    @property
    def told(self) -> dict[str, Any]:
        """The outcome as figures, for JSON."""
        last, draw = self.shots[-1], self.draw
        return {
            "patient": draw.patient, "seed": draw.seed, "view": draw.view, "tier": draw.tier,
            "found": self.found, "declared": self.declared, "true_view": LABELS[last.view],
            "true_grade": round(last.grade, 2), "steps": last.step,
            "scan_seconds": round(STEP_SECONDS * last.step, 1),
            "distance_mm": round(last.distance, 2),
            "believed_distance_mm": round(last.believed, 2),
            "believed_spread_mm": round(last.spread, 2), "believed_grade": round(last.read, 2),
            "pathology": self.heart.patient.pathology, "again": draw.again,
        }  # fmt: skip


def drawn(patient: int | None, seed: int | None, view: str | None, tier: str | None) -> Draw:
    """Return what options say; what they leave open is drawn by the seed, itself by chance.

    Raises:
        RacinesError: an unknown view or tier, or a patient of another split.
    """
    view, tier = view or "A4C", tier or "beating"
    if view not in VIEWS:
        raise RacinesError(f"unknown view {view!r}: choose one of {', '.join(VIEWS)}")
    if tier not in TIERS or tier == HEART_TIER:
        raise RacinesError(f"--tier {tier}: the servo scans patients, choose patients or beating")
    seed = secrets.randbelow(LARGEST) if seed is None else seed
    if patient is None:
        patients = seeds_of(SPLIT)
        share = float(uniform(torch.tensor([seed]), 1, _WHO)[0, 0])
        patient = patients[int(share * len(patients))]
    check_split([patient], SPLIT)
    return Draw(patient, seed, view, tier)


def load_servo() -> Watched:
    """Return the published servo.

    Raises:
        RacinesError: its weights are not here.
    """
    policy = published(POLICY)
    if not policy.is_dir():
        raise RacinesError(
            f"{POLICY}: no such folder: run it in a clone of RACINES, or install the package from "
            "its wheel"
        )
    return Watched.load(policy)


def scan(
    draw: Draw, agent: Watched, seen: Callable[[Heart, Pose, Sequence[Shot]], None] | None = None,
    steps: int | None = None,
) -> Outcome:  # fmt: skip
    """Let the agent look for the view; `seen` is told heart, own pose and the shots at each step.

    Args:
        draw: who, how and from where.
        agent: who looks.
        seen: what watches it live.
        steps: stop after so many; the task's own by default.
    """
    began = time.perf_counter()
    config = PatientsConfig(view=f"{draw.view}-{draw.tier}", split=SPLIT, starts=1)
    ward = make_ward(draw.tier, SPLIT, (draw.patient,))
    case, seeds = ward.case_of([draw.patient]), StartSet((draw.patient,), 1, draw.seed).seeds
    task = config.task if steps is None else replace(config.task, max_steps=steps)
    core = core_for(agent, task, 1, reward="oracle", phantom=ward)
    heart, own = ward.pool.hearts[0], ward.scene(case, torch.zeros(1).double()).target(draw.view)

    def show(shots: list[list[Shot]]) -> None:
        if seen:
            seen(heart, own, shots[0])

    shots = watch(core, agent, seeds, case, show)[0]
    info = core.info(view_error=False)
    declared = bool(info["declared"][0])
    image = core.scene().render(own, derive(core.state.seed, core.state.steps))[0]
    here = Pose(core.state.position, core.state.rotation)
    names = (_named(core, ward, here), _named(core, ward, own))
    return Outcome(
        draw, shots, bool(info["success"][0]) and declared, declared, heart, own,
        image.cpu().numpy(), names, time.perf_counter() - began,
    )  # fmt: skip


def _named(core: ScanCore, ward: Ward, pose: Pose) -> dict[str, tuple[float, float]]:
    """Return where the parts of the heart lie in the plane at the end's moment."""
    time_ = STEP_SECONDS * core.state.steps.double()
    phase = ward.pool.phase(core.state.case, time_) if ward.pool.beating else None
    mask = ward.pool.mask(pose, core.state.case, phase)[0].cpu().numpy()
    places = {}
    for name in CHAMBERS:
        rows, columns = np.nonzero(mask == PARTS.index(name))
        if len(rows) >= _FEWEST:
            middle = np.array([np.median(columns), np.median(rows)]) + 0.5
            places[name] = tuple(float(x) for x in middle / mask.shape)
    return places


def verdict(outcome: Outcome) -> tuple[str, str]:
    """Return whether the view was found, in a line, and what that means in a sentence or two."""
    last, draw = outcome.shots[-1], outcome.draw
    title, seconds = VIEW_TITLES[draw.view], STEP_SECONDS * last.step
    spent = f"after {last.step} steps ({seconds:.0f} s of scanning)"
    if outcome.found:
        head = f"Found: the {title} view"
        text = (
            f"The agent declared the view {spent}. The simulation, which knows the truth, agrees: "
            f"true grade {last.grade:.1f} of 10, {last.distance:.0f} mm from the best pose."
        )
    elif not outcome.declared:
        head = f"Not found: the {title} view"
        text = f"The agent had not declared the view {spent}, when its time was up."
    else:
        head = f"Not found: the agent declared {draw.view}, and it is wrong"
        other = LABELS[last.view]
        what = "no standard view" if other not in VIEWS else f"the {VIEW_TITLES[other]} view"
        why = f"the probe shows {what}"
        if other == draw.view:
            why = "the picture is of the right view but not good enough over a whole heartbeat"
        text = (
            f"The agent declared the view {spent}, but {why}, {last.distance:.0f} mm from the "
            f"best pose. It read its own picture as grade {last.read:.1f} of 10; the truth is "
            f"{last.grade:.1f}."
        )
    return head, text
