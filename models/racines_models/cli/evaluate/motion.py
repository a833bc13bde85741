"""Commands: eval motion, export motion. Heavy imports stand inside, so that --help is instant."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import given, overrides, read_settings
from racines_data.errors import RacinesError
from racines_models.cli.device import Device

if TYPE_CHECKING:
    from racines_models.trackerless.scoring import MotionScoresConfig
    from racines_models.trackerless.sweeps import SweepSet

Name = Annotated[
    str, typer.Argument(help="A registered motion estimator, module:Class, or a submission's file.")
]


def evaluate_motion(
    name: Name,
    data: opt.Data = opt.DATA,
    config: opt.Config = "patients",
    split: opt.OneSplit = None,
    run: opt.Trained = None,
    out: opt.Out = Path("models/runs/motion-scores"),
    settings: opt.Set = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    device: Device = "auto",
    force: opt.Force = False,
    as_json: opt.AsJson = False,
) -> None:
    """Score estimated motion on held-out sweeps; write NAME.json.

    NAME.parquet has the figures of every sweep, from which those in NAME.json follow.
    Settings: section motion_scores; --set pixel_mm=… states the side of a pixel where the data do
    not say it. --split all takes every sweep of recordings that nothing was learned from.
    """
    from racines_data.progress import image_counter
    from racines_models.cli.output import metrics_table, tell
    from racines_models.statistics import write_scores
    from racines_models.trackerless import protocol
    from racines_models.trackerless.scoring import asked, estimate_all, score_motion
    from racines_models.trackerless.submission import read_submission

    values = read_settings(params, profile)
    if protocol.is_submission(name):
        if run is not None:
            raise RacinesError(f"{name} is a file: it has no run ({run}); give one of them")
        submission = read_submission(Path(name))
        sweeps, chosen = _asked(values, data, config, split, settings)
        found = asked(sweeps, chosen)
        submission.check(name, found, sweeps.store.digest, chosen.split)
        title, motions = submission.name, [dict(submission.motions)]
        # A file does not say that nothing was learned: a place takes trainings, as of any method.
        about: dict[str, Any] = {
            "trained": True,
            "weights": {Path(name).name: submission.sha256},
        }
    else:
        estimators = _estimators(name, run, values, device)
        sweeps, chosen = _asked(values, data, config, split, settings)
        found = asked(sweeps, chosen)
        protocol.check_unseen(estimators, sweeps, chosen.split)
        title = estimators[0].name
        total = len(estimators) * sum(map(len, found))
        with image_counter(f"estimating {title}", total, hidden=as_json) as advance:
            motions = estimate_all(estimators, sweeps, found, advance)
        about = protocol.told_of(estimators, run)
    scores = score_motion(title, motions, sweeps, chosen, about, device)
    content = write_scores(out / f"{title}.json", scores.content, scores.evidence, force)
    table = metrics_table(f"{title}, {chosen.split} split", content["metrics"])
    withheld = [f"{key}: {why}" for key, why in content["withheld"].items()]
    tell(content, as_json, table, *withheld, f"{out / title}.json, .parquet")


def export_motion(
    name: Annotated[str, typer.Argument(help="A registered motion estimator, or module:Class.")],
    out: opt.OutFile,
    data: opt.Data = opt.DATA,
    config: opt.Config = "patients",
    split: opt.OneSplit = None,
    run: opt.Trained = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    device: Device = "auto",
    as_json: opt.AsJson = False,
) -> None:
    """Write the motion that an estimator finds on a split's sweeps as a submission.

    The file is an NPZ or a Parquet, by its ending; of several trainings it has the first.
    """
    from racines_data.progress import image_counter
    from racines_models.cli.output import tell
    from racines_models.trackerless.scoring import estimate_all
    from racines_models.trackerless.submission import Submission, write_submission

    if out.suffix.lower() not in (".npz", ".parquet"):
        raise typer.BadParameter(f"{out}: end the name with .npz or .parquet", param_hint="--out")
    values = read_settings(params, profile)
    estimators = _estimators(name, run, values, device)[:1]
    sweeps, chosen = _asked(values, data, config, split, None)
    found, title = sweeps.sweeps(chosen.split), estimators[0].name
    with image_counter(f"estimating {title}", sum(map(len, found)), hidden=as_json) as advance:
        (motions,) = estimate_all(estimators, sweeps, found, advance)
    sha256 = write_submission(out, Submission(title, sweeps.store.digest, chosen.split, motions))
    told = {"out": str(out), "sweeps": len(motions), "split": chosen.split, "sha256": sha256}
    tell(told, as_json, f"{out}: {len(motions)} sweeps of split {chosen.split}")


def _asked(
    values: dict[str, Any], data: Path, config: str, split: str | None, pairs: list[str] | None
) -> "tuple[SweepSet, MotionScoresConfig]":
    from racines_data.config import fill, section
    from racines_data.store.frames import open_store
    from racines_models.trackerless.scoring import MotionScoresConfig
    from racines_models.trackerless.sweeps import SweepSet

    settings = section(values, "motion_scores") | overrides(pairs) | given(split=split)
    chosen = fill(MotionScoresConfig, settings, "motion_scores")
    return SweepSet(open_store(data, config)), chosen


def _estimators(name: str, run: Path | None, values: dict[str, Any], device: str) -> list[Any]:
    from racines_data.config import section
    from racines_models.trackerless.protocol import estimator_class, open_estimators

    settings = section(values, ("motions", estimator_class(name).name))
    return open_estimators(name, run, settings, device)
