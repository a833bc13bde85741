"""The sources of simulated patients: sweeps over many hearts, split by patient, with masks.

`PatientsSource` scans hearts that stand still at end diastole, breathed out; `BeatingSource` scans
the same ones while they beat and breathe. Both add a config of their name to a dataset.

    a patient ──> Pool of that one heart ──> a sweep a view, and one at random
    a sweep   ──> start about the view's middle ─ overshoot ─ correct ─ dwell ─ leave, 10 frames/s

A patient is a session. One heart is in memory at a time (20 MB a worker), all frames of a sweep are
drawn at once, and what is drawn depends on the patient, the sweep and the seed alone.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import torch
from torch import Tensor

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.geometry import Pose, euler_to_matrix
from racines_data.own.heart import heart_provenance, open_heart
from racines_data.own.pool import make_pool
from racines_data.patients.chest import sway_of
from racines_data.patients.labels import LABELS as MASK_LABELS
from racines_data.patients.patient import PATIENTS_VERSION
from racines_data.patients.placement import SURFACE
from racines_data.patients.pool import Pool
from racines_data.patients.splits import SPLITS, check_split, seeds_of
from racines_data.phantom.acquisition import (
    AcquisitionConfig,
    PlannedSweep,
    again,
    around,
    coordinates,
    follow,
    limits_of,
    pose_at,
    random_points,
    record,
    sweep_points,
)
from racines_data.phantom.config import PhantomConfig
from racines_data.phantom.pacing import FREE, first_followed, joint_count, joints_of
from racines_data.randomness import derive, sample_seeds, uniform
from racines_data.schema import Trajectory
from racines_data.sources.base import Finding, SourceCard, Unit, card_with
from racines_data.store.hearts import columns
from racines_data.views import LABELS, MIDDLES, RANDOM, VIEWS
from racines_data.world import LONGEST, STEP_SECONDS

SWEEPS = AcquisitionConfig(rate=1.0 / STEP_SECONDS)
"""Hand and sensors, as over the phantom; a frame each step of the tasks."""
START = 12.0
"""Spread of the starts about a view's middle, mm along and degrees about each axis: the patient's
own view lies 30 mm and 13° from there (medians)."""
_X, _Y, _Z, _RX, _RY, _TURN = np.mean([*MIDDLES.values()], axis=0).tolist()
WANDER = _X, _Y, _TURN
"""Place, x and y, m, and turn, rad, about which a random scan wanders: between the views."""
OPERATORS = 3
WAY = 17
"""Places on the way to a view, from which one in an arm's reach is chosen."""
_REMEDIES = {"time": "raise frames_per_sweep"}
_STREAM, _BEGAN = 0x9A71, 11

CARD = SourceCard(
    origin="simulated ultrasound of simulated patients; no frame comes from a scanner",
    license="cc-by-4.0",
    rights="CC BY 4.0.",
    tags=("simulation", "synthetic"),
    simulated=True,
    collection="Simulated: a seeded operator moves a phased-array probe over simulated patients, "
    "one sweep a view from a start that says nothing of the patient, and one at random. A seed "
    "decides body and sex, the heart's form given them, pathology, place in the chest, ribs and "
    "lung, tissue, the settings of the examination, beat and breath.",
    collection_type="Software Collection",
    annotation="View and grade (0-10) are computed from the true pose and the patient's anatomy, "
    "moved by the phase, with what ribs and lung shade. Masks label each pixel with the chamber or "
    "wall that lies there in the middle plane of the slice. Volumes are counted in what is drawn.",
    biases="One parametric model of adult hearts: sizes within the ranges of Lang et al. (JASE "
    "2015), five pathologies in one of five patients, no congenital disease. One probe, one robot.",
    limitations="Simulated images differ from real echo. Frames of one patient are alike: split by "
    "patient only. Never to be presented as recordings.",
    personal="None: simulated; there is no subject.",
    limits="The images are simulated. Frames of one patient are alike: keep patients whole.",
)


@dataclass(frozen=True)
class PatientsConfig:
    """Who is scanned, and for how long."""

    train: int | tuple[int, ...] = 0
    """Patients of the split: how many, from its first seed on, or their seeds."""
    validation: int | tuple[int, ...] = 0
    test: int | tuple[int, ...] = 0
    frames_per_sweep: int = 24
    """Frames of each of a patient's six sweeps, 0.1 s apart."""
    masks: bool = True
    """Whether frames have masks; without, the column is null."""
    seed: int = 0
    """Draws the sweeps."""
    phantom: str = ""
    """Folder or name of a heart of one's own that all of them have; none if empty."""
    robot: str = FREE
    """An arm, within whose limits every sweep stays; it needs some 40 frames a sweep."""


@dataclass(frozen=True)
class PatientUnit(Unit):
    """A planned sweep over a patient."""

    patient: int = 0
    """Seed of the patient."""
    split: str = ""
    """The split of the patient."""
    index: int = 0
    """Number of the sweep among the patient's."""


class PatientsSource:
    """Scans still hearts; a sweep depends on its patient, its number and the seed alone."""

    name = adds = "patients"
    version = PATIENTS_VERSION
    Config: ClassVar[type] = PatientsConfig
    card = CARD
    labels = LABELS
    beating = False

    def __init__(self, config: PatientsConfig):
        self.config = config
        self.report: list[Finding] = []
        if own := self._own():
            self.card = card_with(CARD, own)

    @classmethod
    def from_config(cls, config: dict[str, Any], inputs: Sequence[Path] = ()) -> Self:
        """Make the source; it reads no input files.

        Raises:
            RacinesError: unknown settings, no patient, more than a split has, one of another
                split, too few frames, or input files given.
        """
        if inputs:
            raise RacinesError(f"{cls.name} reads no --input: drop it, or name another --source")
        where = f"data.{cls.name}"
        source = cls(fill(PatientsConfig, config, where))
        if source.config.frames_per_sweep < 2:
            found = source.config.frames_per_sweep
            raise RacinesError(f"{where}.frames_per_sweep: {found}: give 2 or more")
        if not any(source.seeds(split) for split in SPLITS):
            raise RacinesError(f"{where}: no patient: set train, validation or test")
        if source.config.phantom:
            open_heart(source.config.phantom)
        if source.config.robot != FREE:  # an unknown one is told before the first sweep
            joint_count(source.config.robot)
        return source

    def _own(self) -> dict[str, Any] | None:
        """Return what records say of the heart that all have; None where each has an own one."""
        return heart_provenance(self.config.phantom) if self.config.phantom else None

    def seeds(self, split: str) -> tuple[int, ...]:
        """Return the patients of a split, in order.

        Raises:
            RacinesError: more than the split has, one twice, or one of another split.
        """
        wanted, known = getattr(self.config, split), seeds_of(split)
        where = f"data.{self.name}.{split}"
        if isinstance(wanted, int):
            if not 0 <= wanted <= len(known):
                had = f"the split has {len(known)} patients: give 0 to {len(known)}"
                raise RacinesError(f"{where}: {wanted}: {had}")
            return tuple(known[:wanted])
        if len(set(wanted)) < len(wanted):
            raise RacinesError(f"{where}: a seed stands there twice: name each once")
        try:
            check_split(list(wanted), split)
        except RacinesError as error:
            raise RacinesError(f"{where}: {error}") from None
        return wanted

    @property
    def mask_labels(self) -> tuple[str, ...]:
        """Names of the masks' labels by number; empty where frames have no masks."""
        return MASK_LABELS if self.config.masks else ()

    def recipe(self) -> dict[str, Any]:
        """Return what decides the bytes: versions, hand and sensors, and all settings."""
        acquisition = SWEEPS.told()
        del acquisition["phantom"], acquisition["frames"], acquisition["seed"]
        settings = dataclasses.asdict(self.config)
        del settings["phantom"]  # by its content, wherever its folder lies
        if self.config.robot == FREE:  # it came later
            del settings["robot"]
        own = self._own()
        return {
            "patients": PATIENTS_VERSION,
            "beating": self.beating,
            "acquisition": acquisition,
            "settings": settings,
        } | ({"own": own} if own else {})

    def plan(self) -> Sequence[PatientUnit]:
        """Return the sweeps in order, patient by patient."""
        units, frames = [], self.config.frames_per_sweep
        for split in SPLITS:
            for seed in self.seeds(split):
                for index, target in enumerate(LABELS):
                    name, session = f"p{seed:05d}-{target.lower()}", f"patient-{seed:05d}"
                    units.append(PatientUnit(name, session, target, frames, seed, split, index))
        return units

    def produce(self, unit: Unit) -> Trajectory:
        """Scan one sweep."""
        assert isinstance(unit, PatientUnit)
        pool = _pool(unit.patient, self.beating, self.config.phantom)
        seed = derive(sample_seeds(self.config.seed, 1), _STREAM, unit.patient, unit.index)
        sweep = _sweep(pool, unit, seed, self.config.robot, f"data.{self.name}.robot")
        rows, phase = torch.zeros(unit.frames, dtype=torch.int64), torch.zeros(unit.frames, 2)
        times, phase = sweep.times, phase.double()
        if self.beating:
            times = times + LONGEST * uniform(seed, 1, _BEGAN)[0].double().round(decimals=3)
            phase = pool.phase(rows, times)
        truth = pool.judge(sweep.pose, rows, phase)
        seeds = sample_seeds(int(derive(seed, 3)), unit.frames)
        masks = pool.mask(sweep.pose, rows, phase).numpy() if self.config.masks else None
        return Trajectory(
            id=unit.id,
            session=unit.session,
            target_view=unit.target_view,
            images=pool.render(sweep.pose, rows, phase, seeds).numpy(),
            parameters=record(pool, SWEEPS, sweep, seed).numpy(),
            timestamps=times.numpy(),
            controls=sweep.control.numpy(),
            views=truth.view.numpy(),
            grades=truth.grade.numpy().astype(np.float32),
            patient=unit.patient,
            phases=phase.numpy(),
            masks=masks,
        )

    def measures(self, patient: int) -> dict[str, Any]:
        """Return who a patient is and what is true of the heart: a row of the table of measures."""
        pool = _pool(patient, self.beating, self.config.phantom)
        who, found = pool.patients[0], dataclasses.asdict(pool.measures(0))
        volumes = {f"volume_{part}": list(each) for part, each in found.pop("volumes").items()}
        lasting = {name: found.pop(name) for name in _ENDS}
        ends = {
            f"{name}_{end}": value
            for name, pair in lasting.items()
            for end, value in zip(("diastole", "systole"), pair, strict=True)
        }
        phases = {"phases": list(found.pop("phases"))}
        body = dataclasses.asdict(who.body)
        about = {"patient": patient, "pathology": who.pathology, **body}
        placement = pool.hearts[0].placement
        sway = sway_of(who, placement) * 1e-3
        lies = columns(placement.axes, placement.origin, sway)
        return about | found | ends | lies | phases | volumes | {"shown": _shown(pool)}


class BeatingSource(PatientsSource):
    """Scans hearts that beat, in chests that breathe; times are of the patient's own rhythm."""

    name = adds = "beating"
    beating = True


_ENDS = ("lv_diameter", "lv_length", "wall", "septum")
"""Measures that have two values, at end diastole and at end systole."""


@lru_cache(maxsize=1)
def _pool(patient: int, beating: bool, phantom: str) -> Pool:
    return make_pool([patient], beating=beating, phantom=phantom)


def _sweep(pool: Pool, unit: PatientUnit, seed: Tensor, robot: str, field: str) -> PlannedSweep:
    """Draw one sweep over the one patient of a pool from a (1,) seed.

    Where an arm cannot follow it, others are drawn.

    Raises:
        RacinesError: none of them either.
    """
    limits, operator = limits_of(pool.workspace, SURFACE, PhantomConfig()), unit.patient % OPERATORS
    config = dataclasses.replace(SWEEPS, robot=robot)
    nominal = pool.targets(torch.zeros(1, dtype=torch.int64))
    aims = coordinates(Pose(*(part[0] for part in nominal)))

    def drawn(attempt: int) -> PlannedSweep:
        draw = again(seed, attempt)
        if unit.target_view == RANDOM:
            points, shares = random_points(WANDER, SURFACE, draw)
        else:
            target = aims[VIEWS.index(unit.target_view)]
            touch = around(_middle(unit.target_view), START, draw)
            touch[:, 2] = target[2]
            if robot != FREE:
                target = _in_reach(robot, touch[0], target, attempt)
            points, shares = sweep_points(touch, touch[0], target, SURFACE, draw)
        return follow(points, shares, limits, config, operator, unit.frames, draw)

    sought = f"{field}: patient {unit.patient}, {unit.target_view}"
    return first_followed(drawn, sought, _REMEDIES)


def _in_reach(robot: str, start: Tensor, target: Tensor, attempt: int) -> Tensor:
    """Return the farthest of the (6,) coordinates on the way to a target that an arm reaches.

    One view in a hundred is out of reach. Sweeps that aim at it end short of it, by what they
    overshoot, a fifth of their way, and by more with every attempt, since they swing about their
    aim.
    """
    shares = torch.linspace(0.0, 1.0, WAY).to(target)
    way = torch.lerp(target, start.to(target), shares.unsqueeze(1))
    short = int(joints_of(robot)(pose_at(way)).isfinite().all(1).long().argmax())
    return way[min(short + WAY // 5 + attempt, WAY - 1)] if short else target


def _middle(view: str) -> Tensor:
    """Return the (6,) coordinates about which sweeps to a view start, whoever lies there."""
    place = torch.tensor([MIDDLES[view]])
    return coordinates(Pose(place[:, :3], euler_to_matrix(place[:, 3:])))[0]


def _shown(pool: Pool) -> list[str]:
    """Return the views that the one patient of a pool shows at their nominal poses."""
    nominal = pool.targets(torch.zeros(1, dtype=torch.int64))
    truth = pool.judge(
        Pose(*(part[0] for part in nominal)), torch.zeros(len(VIEWS), dtype=torch.int64)
    )
    return [view for view, own in zip(VIEWS, truth.membership.diag(), strict=True) if own > 0.5]
