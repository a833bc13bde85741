"""The report: what judges of simulated patients say of real frames, tuning and reporting apart.

Nothing here chooses anything: no threshold, no temperature, no weights. A judge is asked about the
frames as they are, and once.
"""

import time
from typing import Any, NamedTuple

import numpy as np
from torch import Tensor

from racines_data.errors import RacinesError
from racines_models.judges.segmentation.model import SegmentationJudge
from racines_models.judges.segmentation.overlap import overlap_figures
from racines_models.judges.segmentation.structures import CAMUS
from racines_models.protocol import Judge
from racines_models.provenance import code_version, environment
from racines_models.studies.realism.patients import LISTS, UNLISTED, list_of
from racines_models.studies.sim_to_real.acceptance import (
    Advance,
    Called,
    accepted,
    accepted_pictures,
    accepted_turns,
    call,
    call_controls,
)
from racines_models.studies.sim_to_real.controls import CONTROLS
from racines_models.studies.sim_to_real.ejection import agreement, ejection_fractions
from racines_models.studies.sim_to_real.frames import RealEcho

SCHEMA = "racines.sim-to-real/1"
VOLUMES = ("end_diastolic_volume", "end_systolic_volume", "ejection_fraction")
UNITS = ("mL", "mL", "%")
MOST = (np.inf, np.inf, 100.0)
"""What each can be at most."""


class Answers(NamedTuple):
    """What the judges said, for the figures; None where it was not asked."""

    controls: dict[str, Called] | None = None
    turns: Called | None = None
    pictures: Called | None = None
    masks: Tensor | None = None
    """(M, 128, 128) uint8 of the frames that cardiologists drew on, CAMUS's numbers."""


class Measured(NamedTuple):
    """The report, and what it rests on."""

    content: dict[str, Any]
    answers: Answers


def images_asked(real: RealEcho, grader: bool, segmentation: bool) -> int:
    """Return how many images the judges will look at."""
    asked = len(CONTROLS) * len(real.frames.images) * grader
    for part in (real.rotation, real.pictures):
        asked += len(part.images) * grader if part else 0
    return asked + (len(real.drawn.masks) * segmentation if real.drawn else 0)


def measure(
    real: RealEcho,
    grader: Judge | None = None,
    segmentation: SegmentationJudge | None = None,
    advance: Advance | None = None,
) -> Measured:
    """Ask the judges about all real frames.

    Raises:
        RacinesError: no judge, a grader of other views, or a segmentation judge and no masks.
    """
    if grader is None and segmentation is None:
        raise RacinesError("no judge: give --grader FOLDER, --segmentation FOLDER, or both")
    began, answers = time.perf_counter(), Answers()
    lists = np.array([list_of(each) for each in real.frames.patient])
    content: dict[str, Any] = {"schema": SCHEMA, "real": _told(real, lists)}
    if grader is not None:
        content["grader"] = grader.settings
        answers = _ask_grader(content, real, lists, grader, advance)
    if segmentation is not None:
        content["segmentation"] = segmentation.settings
        masks = _ask_segmentation(content, real, lists, segmentation, advance)
        answers = answers._replace(masks=masks)
    content |= {"code": code_version(), "environment": environment()}
    content["seconds"] = round(time.perf_counter() - began, 3)
    return Measured(content, answers)


def _told(real: RealEcho, lists: np.ndarray) -> dict[str, Any]:
    """Return what the frames are: hashes and counts."""
    frames, told = real.frames, {}
    for name in present(lists):
        inside = lists == name
        patients = len(np.unique(frames.patient[inside]))
        told[name] = {"frames": int(inside.sum()), "patients": patients}
    described: dict[str, Any] = {"sha256": frames.sha256, "lists": told}
    if real.drawn is not None:
        drawn = real.drawn
        told = {"sha256": drawn.sha256, "frames": len(drawn.masks), "stretched": drawn.stretched}
        described["masks"] = told
    return described


def present(lists: np.ndarray) -> list[str]:
    """Return the names of the lists that (N,) names of patients' lists are of, in order."""
    return [name for name in (*LISTS, UNLISTED) if (lists == name).any()]


def _ask_grader(
    content: dict[str, Any],
    real: RealEcho,
    lists: np.ndarray,
    grader: Judge,
    advance: Advance | None,
) -> Answers:
    labels, answers = grader.labels, Answers(call_controls(grader, real.frames, advance))
    controls = answers.controls or {}
    content["acceptance"] = {
        name: accepted(controls, real.frames.patient, np.flatnonzero(lists == name), labels)
        for name in present(lists)
    }
    if real.pictures is not None:
        called = call(grader, real.pictures.images, advance)
        content["other_views"] = accepted_pictures(called, real.pictures, labels)
        answers = answers._replace(pictures=called)
    if real.rotation is not None:
        called = call(grader, real.rotation.images, advance)
        content["rotation"] = accepted_turns(called, real.rotation, labels)
        answers = answers._replace(turns=called)
    return answers


def _ask_segmentation(
    content: dict[str, Any],
    real: RealEcho,
    lists: np.ndarray,
    judge: SegmentationJudge,
    advance: Advance | None,
) -> Tensor:
    drawn = real.drawn
    if drawn is None:
        raise RacinesError("a segmentation judge needs masks to be held to: give --masks FILE")
    found = judge.segment_camus(real.frames.images[drawn.row])
    if advance is not None:
        advance(len(found))
    patient, phase = real.frames.patient[drawn.row], real.frames.phase[drawn.row]
    content["overlap"], content["volumes"] = {}, {}
    for name in present(lists[drawn.row]):
        rows = np.flatnonzero(lists[drawn.row] == name)
        some, true = found[rows], drawn.masks[rows]
        content["overlap"][name] = overlap_figures(some, true, tuple(CAMUS), patient[rows])
        at = patient[rows], phase[rows], drawn.mm[rows]
        ours, theirs = (ejection_fractions(each.numpy(), *at) for each in (some, true))
        content["volumes"][name] = _volumes(ours, theirs)
    return found


def _volumes(
    ours: dict[str, tuple[float, float, float]], theirs: dict[str, tuple[float, float, float]]
) -> dict[str, Any]:
    """Return agreement in each of `VOLUMES`, and the patients' own figures, judge's first."""
    a, b = (np.array(list(each.values())).reshape(-1, 3) for each in (ours, theirs))
    told: dict[str, Any] = {}
    for place, (name, unit, most) in enumerate(zip(VOLUMES, UNITS, MOST, strict=True)):
        told[name] = agreement(a[:, place], b[:, place], unit, most)
        pairs = np.stack([a[:, place], b[:, place]], 1).tolist()
        rows = zip(ours, pairs, strict=True)
        told[name]["pairs"] = {
            who: [None if np.isnan(value) else round(value, 2) for value in pair]
            for who, pair in rows
        }
    return told
