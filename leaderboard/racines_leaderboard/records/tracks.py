"""The tracks: which metrics they show, in which direction they are good, which ones rank.

Installed packages add columns: each metric of the group `racines.metrics` is one, and so is each
`Column` of the group `racines.columns`. They are shown where a result fills them, and never rank.
"""

import dataclasses
from typing import Any

from racines_data.plugins import Plugins
from racines_envs.task.names import HEART_TIER, tier_of
from racines_leaderboard.records.columns import PLACES, Column, Track
from racines_leaderboard.records.motions import MOTION, MOTION_TRACKS, TURNS, motion_track

GENERATORS = Track(
    name="generators",
    schema="generator-scores",
    subject="generator",
    columns=(
        Column("ssim", "SSIM", "higher"),
        Column("psnr", "PSNR", "higher", 2, unit="dB"),
        Column("fid", "FID", "lower", 1),
        Column("kid", "KID", "lower"),
        Column("pose_error_mm", "Pose error", "lower", 1, unit="mm"),
        Column("pose_error_deg", "Pose error", "lower", 1, unit="°"),
        Column("view_agreement", "View agreement", "higher", 1, 100.0, "%"),
        Column("expert_view", "Expert, view", "higher", 1, 100.0, "%"),
        Column("expert_grade", "Expert, grade", "higher", 1, 100.0, "%"),
    ),
    ranked_by=("ssim", "psnr", "fid", "kid", "pose_error_mm"),
    anchors=("mean-image", "noise-ceiling"),
    bounds=("mean-image", "noise-ceiling", "nearest-pose"),
    rule=(
        "Score: the mean of SSIM, PSNR, FID, KID and pose error (mm), each from 0 at mean-image to "
        f"1 at noise-ceiling, whose figures are fixed for the board. {PLACES}"
    ),
    counted="frames of the test split",
    unit="trajectories",
    details=(
        Column("ms_ssim", "MS-SSIM", "higher"),
        Column("fid_grader", "FID, grader", "lower", 2),
        Column("kid_grader", "KID, grader", "lower"),
        Column("precision", "Precision", "higher", 2),
        Column("recall", "Recall", "higher", 2),
        Column("density", "Density", "higher", 2),
        Column("coverage", "Coverage", "higher", 2),
        Column("grade_error", "Grade error", "lower", 2),
        Column("diversity", "Diversity", "none", 1, unit="gray"),
        Column("copies", "Copies", "lower", 1, 100.0, "%"),
        Column("images_per_second_1", "Images/s, one", "none", 0),
        Column("images_per_second_64", "Images/s, 64", "none", 0),
    ),
)

AGENTS = Track(
    name="agents",
    schema="agent-scores",
    subject="agent",
    columns=(
        Column("success_true", "True success", "higher", 1, 100.0, "%"),
        Column("steps", "Steps to success", "lower", 1),
        Column("final_grade", "Final grade", "higher", 2),
        Column("spl", "SPL", "higher"),
        Column("success_grader", "Grader's success", "none", 1, 100.0, "%"),
        Column("peak_force", "Peak force", "lower", 1, unit="N"),
        Column("violations", "Violations", "lower", 1),
        Column("return", "Return", "none", 1),
    ),
    ranked_by=("success_true", "spl", "final_grade"),
    anchors=("random", "planner"),
    bounds=(),
    rule=(
        "Score: the mean of true success, SPL and final grade, each from 0 at random to 1 at "
        f"planner, whose figures are fixed for the task; the return never ranks. {PLACES}"
    ),
    counted="episodes from the fixed starts",
    unit="starts",
)

PATIENT_AGENTS = Track(
    name="patient-agents",
    schema="agent-scores",
    subject="agent",
    columns=(
        Column("success_declared", "Found and declared", "higher", 1, 100.0, "%"),
        Column("reached", "Passed through", "none", 1, 100.0, "%"),
        Column("false_declarations", "Declared wrongly", "lower", 1, 100.0, "%"),
        Column("seconds", "Time", "lower", 1, unit="s"),
        Column("position_error_median", "Distance, median", "lower", 1, unit="mm"),
        Column("rotation_error_median", "Angle, median", "lower", 1, unit="°"),
        Column("final_grade", "Final grade", "higher", 2),
        Column("peak_force", "Peak force", "lower", 1, unit="N"),
        Column("disturbed_found", "Disturbed, validation patients", "higher", 1, 100.0, "%"),
    ),
    ranked_by=("success_declared",),
    anchors=("constant-pose", "planner"),
    bounds=(),
    rule=(
        "Score: the share of the starts from which the view is found and declared, from 0 at "
        "constant-pose, the pose that shows the view in most train patients, to 1 at planner, who "
        "is told the truth; both are fixed for the task. Distance and angle to the patient's "
        f"nominal pose at the end count all episodes, failures included. {PLACES}"
    ),
    counted="episodes on patients whom nobody trained on",
    unit="patients",
    details=(
        Column("declared", "Declared", "none", 1, 100.0, "%"),
        Column("episode_steps", "Steps", "lower", 1),
        Column("position_error_quartile", "Distance, lower quartile", "lower", 1, unit="mm"),
        Column("position_error_upper_quartile", "… upper", "lower", 1, unit="mm"),
        Column("rotation_error_quartile", "Angle, lower quartile", "lower", 1, unit="°"),
        Column("rotation_error_upper_quartile", "… upper", "lower", 1, unit="°"),
        Column("violations", "Violations", "lower", 1),
        Column("return", "Return", "none", 1),
    ),
    own_starts=True,
)
"""Agents on hearts that nobody trained on; their records are scores like those of `agents`."""

PATIENT_GENERATORS = Track(
    name="patient-generators",
    schema="generator-scores",
    subject="generator",
    columns=(
        Column("ssim", "SSIM", "higher"),
        Column("psnr", "PSNR", "higher", 2, unit="dB"),
        Column("kid", "KID", "lower"),
        Column("pose_error_mm", "Pose error", "lower", 1, unit="mm"),
        Column("pose_error_deg", "Pose error", "lower", 1, unit="°"),
        Column("dice", "Dice of what is seen", "higher"),
        Column("fid", "FID", "lower", 1),
        Column("seconds_to_adapt", "Time to adapt", "lower", 2, unit="s"),
    ),
    ranked_by=("ssim", "psnr", "kid", "pose_error_mm", "dice"),
    anchors=("mean-image", "noise-ceiling"),
    bounds=("mean-image", "noise-ceiling", "nearest-pose"),
    rule=(
        "Score: the mean of SSIM, PSNR, KID, pose error (mm) and Dice, each from 0 at mean-image "
        "to 1 at noise-ceiling, the patients scanned again, whose figures are fixed for the board. "
        "Each patient is met by a scout of 64 frames; the poses that are asked for lie up to 20 mm "
        f"from it, where 1 degree counts 1.2 mm. nearest-pose looks them up there. {PLACES}"
    ),
    counted="frames of patients whom nobody trained on",
    unit="patients",
    details=(
        Column("ms_ssim", "MS-SSIM", "higher"),
        Column("precision", "Precision", "higher", 2),
        Column("recall", "Recall", "higher", 2),
        Column("density", "Density", "higher", 2),
        Column("coverage", "Coverage", "higher", 2),
        Column("dice_lv", "Dice, LV", "higher"),
        Column("dice_lv_myocardium", "… its myocardium", "higher"),
        Column("dice_la", "… LA", "higher"),
    ),
)
"""Generators that meet hearts which nobody trained on; scored as those of `generators`."""

TURN_GENERATORS = Track(
    name="turn-generators",
    schema="generator-scores",
    subject="generator",
    columns=(
        Column("ssim", "SSIM", "higher"),
        Column("psnr", "PSNR", "higher", 2, unit="dB"),
        Column("feature_distance", "Distance in features", "lower", 2),
        Column("fid", "FID", "lower", 1),
        Column("kid", "KID", "lower"),
    ),
    ranked_by=("ssim", "psnr", "feature_distance"),
    anchors=("mean-image", "neighbouring-frame"),
    bounds=("mean-image", "neighbouring-frame", "nearest-pose"),
    rule=(
        "One heart, one recording: n = 1 patient, and no interval says anything of another. Score: "
        "the mean of SSIM, PSNR and distance in features, each from 0 at mean-image to 1 at "
        "neighbouring-frame, the real frame of the next turn at the same phase, whose figures are "
        "fixed for the board. There are no forces, views, grades or poses read back, and no "
        f"millimetres where the size of a pixel is not known. {PLACES}"
    ),
    counted="frames of held-out turns of one heart",
    unit="sectors of turns",
    details=(
        Column("ssim_train", "SSIM of the nearest training turn", "none"),
        Column("ms_ssim", "MS-SSIM", "higher"),
        Column("precision", "Precision", "higher", 2),
        Column("recall", "Recall", "higher", 2),
        Column("density", "Density", "higher", 2),
        Column("coverage", "Coverage", "higher", 2),
        Column("diversity", "Diversity", "none", 1, unit="gray"),
        Column("copies", "Copies", "lower", 1, 100.0, "%"),
        Column("images_per_second_1", "Images/s, one", "none", 0),
        Column("images_per_second_64", "Images/s, 64", "none", 0),
    ),
)
"""Generators of recorded turns about the apex; scored as those of `generators`."""

TRACKS = (
    *(GENERATORS, AGENTS, PATIENT_AGENTS, PATIENT_GENERATORS, TURN_GENERATORS),
    *MOTION_TRACKS,
)
SCOUTS = "scouts"
"""Source of the frames that generators on patients are scored on."""
BY_SOURCE = {SCOUTS: PATIENT_GENERATORS, TURNS: TURN_GENERATORS}
"""Tracks of generators by the source of the frames that they are scored on; else `generators`."""
TRACK = {track.name: track for track in TRACKS}
HELD_OUT = (GENERATORS.name, TURN_GENERATORS.name)
"""Tracks of generators that are scored on the held-out frames of one dataset."""
TIERS = ("self-reported", "recomputed", "reproduced")
COLUMNS = Plugins("board column", "racines.columns", ("key", "title", "track"), "module:COLUMN")


def track_of(scores: dict[str, Any]) -> Track | None:
    """Return the track of scores by their schema and by who is scanned.

    None for scores of no track.
    """
    declared = scores.get("schema")
    if declared == f"racines.{GENERATORS.schema}/1":
        data = scores.get("dataset")
        source = data.get("source") if isinstance(data, dict) else None
        return BY_SOURCE.get(str(source), GENERATORS)
    if declared == f"racines.{MOTION.schema}/1":
        return motion_track(scores)
    if declared != f"racines.{AGENTS.schema}/1":
        return None
    task = scores.get("task")
    name = task.get("view") if isinstance(task, dict) else None
    one_heart = not isinstance(name, str) or tier_of(name) == HEART_TIER
    return AGENTS if one_heart else PATIENT_AGENTS


def board_tracks() -> tuple[Track, ...]:
    """Return the tracks with the columns of installed packages after their own.

    Raises:
        RacinesError: a column or a metric that cannot be imported, by its entry point.
    """
    from racines_models.scores.plugin import installed_metrics

    columns: list[Column] = [
        Column(each.name, each.label, each.better, each.digits, each.scale, each.unit)
        for each in installed_metrics()
    ]
    columns += [COLUMNS.load(name) for name in COLUMNS.names()]
    shown = [(*track.columns, *(c for c in columns if c.track == track.name)) for track in TRACKS]
    pairs = zip(TRACKS, shown, strict=True)
    return tuple(dataclasses.replace(track, columns=each) for track, each in pairs)
