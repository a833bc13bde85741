"""The tracks of who estimates the probe's motion, by what can be told of the errors.

motion           where pixels lie is known: errors of pixels and landmarks, mm
tracked-motion   positions are metres, the size of a pixel is unknown: errors of the probe
turn-motion      turns about a point, or positions without metres: angles alone
"""

from typing import Any

from racines_leaderboard.records.columns import PLACES, Column, Track

_ANCHORS, _BOUNDS = ("no-motion",), ("no-motion", "constant-motion", "mean-motion")
_ENDS = (
    "each from 0 at no-motion, whose figures are fixed for the board, to 1 at the true motion, "
    "whose errors are 0"
)
_TOLD = "constant-motion is told how the sweep begins."
_FEW = "One or two recordings: no interval says anything of another."
_LONE = (
    "Where there is one recording, no difference has an interval, so that nobody is ahead of "
    "anybody, and brackets are over trainings alone."
)

_DRIFT_MM = Column("drift_mm", "Drift", "lower", 1, unit="mm")
_DRIFT_DEG = Column("drift_deg", "Drift", "lower", 1, unit="°")
_STEP_MM = Column("step_mm", "Step", "lower", 2, unit="mm")
_STEP_DEG = Column("step_deg", "Step", "lower", 2, unit="°")

MOTION = Track(
    name="motion",
    schema="motion-scores",
    subject="motion",
    columns=(
        Column("gpe", "GPE", "lower", 1, unit="mm"),
        Column("gle", "GLE", "lower", 1, unit="mm"),
        Column("lpe", "LPE", "lower", 1, unit="mm"),
        Column("lle", "LLE", "lower", 1, unit="mm"),
        _DRIFT_MM,
        _DRIFT_DEG,
    ),
    ranked_by=("gpe", "gle", "lpe", "lle"),
    anchors=_ANCHORS,
    bounds=_BOUNDS,
    rule=f"Score: the mean of GPE, GLE, LPE and LLE, {_ENDS}. {_TOLD} {PLACES}",
    counted="sweeps of the test split",
    unit="patients",
    details=(
        _STEP_MM,
        _STEP_DEG,
        Column("score", "Score, a sweep at a time", "higher"),
    ),
    exact=0.0,
)
"""Who estimates the probe's motion from images alone; see `racines_models.trackerless`."""

TRACKED_MOTION = Track(
    name="tracked-motion",
    schema="motion-scores",
    subject="motion",
    columns=(
        _DRIFT_MM,
        _DRIFT_DEG,
        _STEP_MM,
        _STEP_DEG,
    ),
    ranked_by=("drift_mm", "drift_deg", "step_mm", "step_deg"),
    anchors=_ANCHORS,
    bounds=_BOUNDS,
    rule=(
        f"{_FEW} Score: the mean of drift and step of the probe, in mm and in degrees, {_ENDS}. "
        "The size of a pixel is unknown, so that errors of pixels are not told. Intervals of two "
        f"recordings are wide beyond use. {_LONE} {_TOLD} {PLACES}"
    ),
    counted="recorded sweeps",
    unit="recordings",
    exact=0.0,
)
"""Estimates on tracked sweeps of which nobody says where their pixels lie."""

TURN_MOTION = Track(
    name="turn-motion",
    schema="motion-scores",
    subject="motion",
    columns=(
        _STEP_DEG,
        _DRIFT_DEG,
    ),
    # A probe that goes round ends near its start, whatever happened on the way: drift ranks nobody.
    ranked_by=("step_deg",),
    anchors=_ANCHORS,
    bounds=_BOUNDS,
    rule=(
        f"{_FEW} Score: 1 - step / step of no-motion: from 0 at no-motion, whose figures are fixed "
        "for the board, to 1 at the true motion, whose error is 0. Angles alone, as positions have "
        "no metres; drift does not rank, since the probe ends near its start. "
        f"{_LONE} {_TOLD} {PLACES}"
    ),
    counted="sweeps over the turns, one at each phase of the beat",
    unit="recordings",
    exact=0.0,
)
"""Estimates on recorded turns about an apex, of which angles are told."""

MOTION_TRACKS = (MOTION, TRACKED_MOTION, TURN_MOTION)
MOVING = tuple(track.name for track in MOTION_TRACKS)
"""Tracks of who estimates motion."""
SIMULATED = ("phantom", "patients")
"""Sources of sweeps whose pixels are known by their recipe."""
TURNS = "rotation"
"""Source of turns about an apex."""


def motion_track(scores: dict[str, Any]) -> Track:
    """Return the track of scores of estimated motion, by their source and by what they tell."""
    data, metrics = (scores.get(key) for key in ("dataset", "metrics"))
    source = data.get("source") if isinstance(data, dict) else None
    told = metrics if isinstance(metrics, dict) else {}
    if source in SIMULATED or all(key in told for key in MOTION.ranked_by):
        return MOTION
    lengths = all(key in told for key in ("drift_mm", "step_mm"))
    return TRACKED_MOTION if lengths and source != TURNS else TURN_MOTION
