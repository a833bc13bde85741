"""What a found view is good for: the ejection fraction measured there, and where its error is from.

    probe held where the agent ended, for a beat ── 25 pictures ── outlines ── disks ── EDV, ESV, EF

The same is done with the true outlines in place of the judge's, and with the planner's pose, who is
told where the view is, in place of the agent's. What the planner's true outlines miss is geometry:
one plane and round disks. What the agent's true outlines miss beyond that is the view; what the
judge's outlines miss beyond those is the segmentation.

Each training's part of each chunk of patients is kept as it is done; a study that was killed goes
on.
"""

import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from matplotlib.figure import Figure
from torch import Tensor

from racines_data.digest import recipe_digest
from racines_data.errors import RacinesError
from racines_data.escape import visible
from racines_data.geometry import Pose
from racines_data.patients.labels import LABELS
from racines_data.patients.pool import Pool
from racines_data.plotting import MUTED, OURS, PAPER, card_style, encode
from racines_data.randomness import derive
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.protocol import Agent
from racines_envs.agents.rollout import rollout
from racines_envs.agents.trace import refuse_trace
from racines_envs.evaluation.patients import (
    PatientsConfig,
    StartSet,
    open_agents,
    refuse_arm,
    start_set,
    world_of,
)
from racines_envs.evaluation.run import core_for
from racines_envs.evaluation.told import told_of_agent
from racines_envs.studies.kept import Kept
from racines_envs.task.core import ScanCore
from racines_envs.task.names import BEATING
from racines_envs.task.tiers import STEP_SECONDS
from racines_envs.worlds.ward import Ward, make_ward
from racines_models.devices import on_device
from racines_models.judges.segmentation.model import SegmentationJudge
from racines_models.judges.segmentation.structures import relabel, to_camus, to_structures
from racines_models.studies.sim_to_real.ejection import agreement, measure_ventricle

SCHEMA = "racines.ejection/1"
FRAMES = 25
"""Pictures of the beat for which the probe is held."""
STREAM = 457
OUTLINES, POSES = ("judge", "truth"), ("agent", "planner")
FIGURES = {
    "end_diastolic_volume": ("mL", np.inf), "end_systolic_volume": ("mL", np.inf),
    "ejection_fraction": ("%", 100.0), "long_axis": ("mm", np.inf),
}  # fmt: skip
"""What is told of a beat: its unit, and the most that it can be."""
INKS = (OURS, PAPER)


@dataclass(frozen=True)
class EjectionConfig(PatientsConfig):
    """On whom it is measured."""

    view: str = "A4C-beating"
    patients: int = 40
    starts: int = 1


class Beat(NamedTuple):
    """One way to measure N beats: (N,) each, NaN where no ventricle is seen."""

    full: np.ndarray
    """End-diastolic volume, mL: the largest of the beat."""
    empty: np.ndarray
    """End-systolic volume, mL: the smallest."""
    length: np.ndarray
    """Of the ventricle's long axis, mm: the longest of the beat."""

    @property
    def fraction(self) -> np.ndarray:
        """Ejection fraction, per cent."""
        return 100.0 * (self.full - self.empty) / self.full


Measured = dict[tuple[str, str], list[Beat]]
"""By pose and outlines, the beats of each training, or of the planner alone."""


def study_ejection(
    name: str,
    run_dir: Path,
    config: EjectionConfig,
    segmentation: SegmentationJudge,
    run: str | None = None,
    advance: Callable[[int], None] | None = None,
    keep: Path | None = None,
    force: bool = False,
) -> tuple[dict[str, Any], Measured, Beat]:
    """Let an agent find A4C, hold the probe there for a beat, and measure.

    Args:
        name: as of `evaluate_patients`.
        run_dir: likewise.
        config: all settings.
        segmentation: who outlines.
        run: what the agent is called.
        advance: told how many patients are through.
        keep: a JSON file that holds what is done, from which a study that was killed goes on. It
            stays, for who calls to remove when the report is safe.
        force: let it take the place of another study's.

    Returns:
        The report, all that was measured, and what is true, an entry an episode.

    Raises:
        RacinesError: as `evaluate_patients`; hearts that do not beat, or another view; without
            `force`, a file `keep` of another study.
    """
    config, began = on_device(config), time.perf_counter()
    refuse_arm(config, "ejection")
    if config.task.tier != BEATING or config.task.view != "A4C":
        raise RacinesError(
            f"ejection.view {config.view}: an ejection fraction is measured in A4C of beating "
            "hearts: A4C-beating"
        )
    starts = start_set(config)
    agents, trainings = open_agents(name, run_dir, config)
    refuse_trace(agents[0])
    about = told_of_agent(agents[0], trainings, config.device)
    report: dict[str, Any] = {"schema": SCHEMA, **about, "agent": run or about["agent"]}
    report |= {"task": {"view": config.view, "start_set": starts.told(config)}}
    report |= {"phantom": world_of(config), "segmentation": segmentation.settings}
    kept = Kept.open(keep, _identity(report, config), force)
    parts: list[tuple[Measured, Beat, np.ndarray, Beat]] = []
    for chunk in starts.chunks(config.chunk):
        parts.append(_chunk(agents, config, chunk, segmentation, kept))
        if advance is not None:
            advance(len(chunk.patients))
    measured = {
        key: [_joined([part[0][key][row] for part in parts]) for row in range(len(own))]
        for key, own in parts[0][0].items()
    }
    truth = _joined([part[1] for part in parts])
    declared = np.concatenate([part[2] for part in parts], 1)
    report |= {"frames": FRAMES, "found_and_declared": float(declared.mean())}
    report["agreement"] = {
        f"{pose}, {outline}": _agreement(own, truth, starts.units)
        for (pose, outline), own in measured.items()
    }
    held = {pose: measured[pose, "truth"] for pose in POSES}
    held["nominal"] = [_joined([part[3] for part in parts])]
    report["foreshortening"] = {
        pose: _foreshortening(own, truth, starts.units) for pose, own in held.items()
    }
    report["errors"] = _errors(measured, truth)
    report["seconds"] = kept.spent + time.perf_counter() - began
    return report, measured, truth


def _identity(report: dict[str, Any], config: EjectionConfig) -> str:
    """Return a digest of all that decides the figures, and of how patients are cut to chunks."""
    aside = ("device", "robot")
    settings = {key: value for key, value in asdict(config).items() if key not in aside}
    names = ("schema", "agent", "weights", "task", "phantom", "segmentation", "code")
    parts = {name: report[name] for name in names} | {"settings": settings, "frames": FRAMES}
    return recipe_digest(json.loads(json.dumps(parts)))


def _chunk(
    agents: Sequence[Agent], config: EjectionConfig, starts: StartSet, judge: SegmentationJudge,
    kept: Kept,
) -> tuple[Measured, Beat, np.ndarray, Beat]:  # fmt: skip
    """Return what is measured on a chunk's patients, the truth, and (R, N) who found the view.

    Last what true outlines say at the patients' nominal poses.
    """
    made: list[Ward] = []

    def ward() -> Ward:
        """Bake the hearts, if any part is still to be done."""
        if not made:
            made.append(
                make_ward(
                    BEATING, config.split, starts.patients, config.device, phantom=config.phantom
                )
            )
        return made[0]

    whose = f"patients {starts.patients[0]} to {starts.patients[-1]}"
    found: Measured = {(pose, outline): [] for pose in POSES for outline in OUTLINES}
    declared = []
    for who, training, agent in _who(agents):
        part = kept.part(
            f"{who}, training {training}, {whose}",
            partial(_held, agent, config, starts, judge, ward),
        )
        if who == "agent":
            declared.append(part["declared"])
        for outline in OUTLINES:
            found[who, outline].append(Beat(*(part[f"{outline}.{key}"] for key in Beat._fields)))
    true = kept.part(f"truth, {whose}", partial(_true, starts, ward))
    nominal = kept.part(f"nominal, {whose}", partial(_nominal, starts, ward, judge))
    truth, own = (Beat(*(part[key] for key in Beat._fields)) for part in (true, nominal))
    return found, truth, np.stack(declared), own


def _who(agents: Sequence[Agent]) -> Iterator[tuple[str, int, Agent]]:
    """Yield who acts: the agent's trainings, then the planner."""
    yield from (("agent", row, agent) for row, agent in enumerate(agents))
    yield "planner", 0, PlannerAgent()


def _held(
    agent: Agent, config: EjectionConfig, starts: StartSet, judge: SegmentationJudge,
    ward: Callable[[], Ward],
) -> dict[str, np.ndarray]:  # fmt: skip
    """Return what one agent's (N,) episodes come to, by outlines, and who found the view."""
    case, seeds = ward().case_of(starts.units.tolist()), starts.seeds
    core = core_for(
        agent, config.task, len(seeds), reward="oracle", phantom=ward(), device=config.device
    )
    final = rollout(core, agent, seeds.to(core.device), case).final
    told = {"declared": (final["success"] > 0) & (final["declared"] > 0)}
    for outline, beat in zip(OUTLINES, hold(ward().pool, core, judge), strict=True):
        told |= {f"{outline}.{key}": column for key, column in beat._asdict().items()}
    return told


def _true(starts: StartSet, ward: Callable[[], Ward]) -> dict[str, np.ndarray]:
    """Return the true volumes and lengths of (N,) episodes' patients."""
    every = [ward().pool.measures(row) for row in range(len(starts.patients))]
    true = [[each.volumes["lv"][0], each.volumes["lv"][-1], each.lv_length[0]] for each in every]
    return Beat(*np.repeat(np.array(true), starts.starts, 0).T)._asdict()


def _nominal(
    starts: StartSet, ward: Callable[[], Ward], judge: SegmentationJudge
) -> dict[str, np.ndarray]:
    """Return what true outlines say at the nominal poses of (N,) episodes' patients.

    No plane is better there, so that what is short of the true length is the ruler's.
    """
    case = ward().case_of(starts.units.tolist())
    begun = torch.zeros(len(case), dtype=torch.float64)
    pose = ward().scene(case, begun).target("A4C")
    return _outlined(ward().pool, pose, case, *_beats(ward().pool, case, begun), judge)._asdict()


def hold(pool: Pool, core: ScanCore, judge: SegmentationJudge) -> tuple[Beat, Beat]:
    """Hold the probes of N rows for a beat; return what the judge's and the true outlines say."""
    state = core.state
    rows, phase = _beats(pool, state.case, state.began + STEP_SECONDS * state.steps)
    pose = Pose(*(part.repeat_interleave(FRAMES, 0) for part in state.pose))
    seeds = derive(state.seed.repeat_interleave(FRAMES), STREAM, torch.arange(len(rows)) % FRAMES)
    masks = judge.segment_camus(pool.render(pose, rows, phase, seeds))
    size = pool.pixel_size(state.case).cpu().numpy()
    judged = _beat(masks.unflatten(0, (len(state.case), FRAMES)), size)
    return judged, _outlined(pool, state.pose, state.case, rows, phase, judge)


def _beats(pool: Pool, case: Tensor, begun: Tensor) -> tuple[Tensor, Tensor]:
    """Return the rows and phases of the pictures of N beats, (N * FRAMES,) and two of each."""
    rows = case.repeat_interleave(FRAMES)
    beats = torch.tensor([60.0 / each.motion.rate for each in pool.patients], dtype=torch.float64)
    within = torch.arange(FRAMES, dtype=torch.float64).repeat(len(case)) / FRAMES
    when = begun.repeat_interleave(FRAMES) + within * beats.to(rows.device)[rows]
    return rows, pool.phase(rows, when)


def _outlined(
    pool: Pool, pose: Pose, case: Tensor, rows: Tensor, phase: Tensor, judge: SegmentationJudge
) -> Beat:
    """Return what the true outlines of N held poses say, in the structures of the judge."""
    held = Pose(*(part.repeat_interleave(FRAMES, 0) for part in pose))
    own = relabel(pool.mask(held, rows, phase), to_structures(LABELS, judge.structures))
    masks = relabel(own, to_camus(judge.structures)).cpu()
    return _beat(masks.unflatten(0, (len(case), FRAMES)), pool.pixel_size(case).cpu().numpy())


def _beat(masks: Tensor, size: np.ndarray) -> Beat:
    """Return the volumes and lengths of (N, FRAMES, H, W) masks with (N,) mm a pixel."""
    found = np.array(
        [
            [measure_ventricle(mask, np.array([mm, mm])) for mask in row]
            for row, mm in zip(masks.numpy(), size, strict=True)
        ]
    )
    return Beat(*_extremes(found[..., 0]), _extremes(found[..., 1])[0])


def _extremes(volumes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest and smallest of (N, FRAMES) figures, after a median over three moments.

    A beat in which fewer than half of the pictures show a ventricle is not measured.
    """
    around = np.stack([np.roll(volumes, shift, 1) for shift in (-1, 0, 1)])
    seen = np.isfinite(around).any(0)
    calm = np.full(volumes.shape, np.nan)
    calm[seen] = np.nanmedian(around[:, seen], 0)
    enough = np.isfinite(volumes).mean(1) >= 0.5
    full, empty = np.full(len(volumes), np.nan), np.full(len(volumes), np.nan)
    full[enough], empty[enough] = np.nanmax(calm[enough], 1), np.nanmin(calm[enough], 1)
    return full, empty


def _joined(beats: Sequence[Beat]) -> Beat:
    return Beat(*(np.concatenate(column) for column in zip(*beats, strict=True)))


def _figures(beat: Beat) -> tuple[np.ndarray, ...]:
    """Return a beat's figures in the order of `FIGURES`."""
    return beat.full, beat.empty, beat.fraction, beat.length


def _agreement(own: Sequence[Beat], truth: Beat, units: np.ndarray) -> dict[str, Any]:
    """Return bias, limits and correlation of each figure; patients are the units."""
    several = zip(*(_figures(each) for each in own), strict=True)
    return {
        name: agreement(np.stack(found), true, unit, most, units)
        for (name, (unit, most)), found, true in zip(
            FIGURES.items(), several, _figures(truth), strict=True
        )
    }


def _foreshortening(own: Sequence[Beat], truth: Beat, units: np.ndarray) -> dict[str, Any]:
    """Return how much of the true long axis true outlines show, per cent of it: 100 is all.

    Its `bias` is the mean foreshortening, negative where the axis in the plane is shorter.
    """
    shown = np.stack([100.0 * each.length / truth.length for each in own])
    told = agreement(shown, np.full(len(units), 100.0), "%", units=units)
    told.pop("correlation", None)  # the whole axis is the same for all
    return told


def _errors(measured: Measured, truth: Beat) -> dict[str, float | None]:
    """Return the mean absolute errors of the ejection fraction by what they are from.

    `total`; `geometry`, of the planner's true outlines; `view`, how far the agent's pose moves what
    true outlines say; `segmentation`, how far the judge's outlines move it from there. Of episodes
    in which all are measured.
    """
    (plane,) = measured["planner", "truth"]
    found: dict[str, list[np.ndarray]] = {}
    for judged, drawn in zip(measured["agent", "judge"], measured["agent", "truth"], strict=True):
        parts = {
            "total": judged.fraction - truth.fraction,
            "geometry": plane.fraction - truth.fraction,
            "view": drawn.fraction - plane.fraction,
            "segmentation": judged.fraction - drawn.fraction,
        }
        whole = np.isfinite(np.stack(list(parts.values()))).all(0)
        for name, each in parts.items():
            found.setdefault(name, []).append(np.abs(each[whole]))
    joined = {name: np.concatenate(each) for name, each in found.items()}
    return {name: float(each.mean()) if len(each) else None for name, each in joined.items()}


@card_style()
def draw_ejection(report: dict[str, Any], measured: Measured, truth: Beat) -> bytes:
    """Return a PNG: measured against true ejection fractions, and their differences (Bland-Altman).

    The first training of the agent; a dot an episode.
    """
    canvas = Figure(figsize=(8.6, 4.2), layout="constrained")
    left, right = canvas.subplots(1, 2)
    shown = {"agent's pose, judge's outlines": ("agent", "judge"),
             "planner's pose, true outlines": ("planner", "truth")}  # fmt: skip
    true = truth.fraction
    left.plot([0, 90], [0, 90], color=MUTED, linewidth=0.9)
    for ink, (title, key) in zip(INKS, shown.items(), strict=True):
        found = measured[key][0].fraction
        left.plot(true, found, "o", color=ink, markersize=4, alpha=0.8, label=title)
        right.plot((found + true) / 2, found - true, "o", color=ink, markersize=4, alpha=0.8)
        told = report["agreement"][", ".join(key)]["ejection_fraction"]
        for name, style in (("bias", "-"), ("lower_limit", ":"), ("upper_limit", ":")):
            if name in told:
                right.axhline(told[name]["value"], color=ink, linestyle=style, linewidth=1.1)
    left.set(xlabel="true ejection fraction, %", ylabel="measured, %", xlim=(0, 90), ylim=(0, 90))
    right.set(xlabel="mean of both, %", ylabel="measured less true, percentage points")
    left.legend(loc="lower right")
    count = len(true)
    right.set_title("lines: bias and limits of agreement")
    left.set_title(f"{visible(report['agent'])} on {report['task']['view']}, n = {count}")
    return encode(canvas, dpi=150)
