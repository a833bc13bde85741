"""Commands: eval grader, data annotate. Heavy imports stand inside, so that --help is instant."""

from pathlib import Path
from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_models.cli.device import Device


def eval_grader(
    run: Annotated[Path, typer.Argument(help="Folder of a grader or a student.")] = opt.GRADER,
    data: opt.Data = opt.DATA,
    config: opt.Config = "frames",
    split: opt.Split = "test",
    out: opt.OwnOut = None,
    recalibrate: Annotated[
        bool,
        typer.Option("--calibrate", help="First fit its temperature on the validation split."),
    ] = False,
    device: Device = "auto",
    as_json: opt.AsJson = False,
) -> None:
    """Report a grader on a split: accuracy, calibration, grade error by view, and the plots.

    They go to --out, or RUN for the test split and RUN/SPLIT for the others.
    """
    from racines_data.store.frames import open_store
    from racines_models.cli.output import judge_figures, metrics_table, tell
    from racines_models.judges.grader.evaluation import evaluate_grader

    out = out or (run if split == "test" else run / split)
    metrics = evaluate_grader(run, open_store(data, config), split, out, recalibrate, device)
    table = metrics_table(f"{run}, {split} split", judge_figures(metrics))
    written = f"{out}: metrics.json, {', '.join(metrics['plots'])}"
    tell({"out": str(out)} | metrics, as_json, table, written)


def annotate(
    root: opt.Root = None,
    grader: opt.Grader = opt.GRADER,
    out: opt.OwnOut = None,
    device: Device = "auto",
    engine: opt.Engine = "local",
    address: opt.Address = None,
    as_json: opt.AsJson = False,
) -> None:
    """Write a grader's view and grade of every frame into view_predicted and grade_predicted.

    The dataset itself is written anew, or a copy of it at --out.
    """
    from racines_data.manifest import default_root, read_manifest
    from racines_data.progress import image_counter
    from racines_models.cli.device import spread
    from racines_models.cli.output import metrics_table, tell
    from racines_models.judges.grader.annotate import annotate as annotate_dataset
    from racines_models.judges.grader.model import Grader

    folder = default_root(root)
    total = read_manifest(folder)["counts"]["frames"]
    judge = Grader.load(grader or opt.GRADER, device)
    counter = image_counter("annotating", total, hidden=as_json)
    with spread(engine, address, device) as pool, counter as advance:
        manifest = annotate_dataset(folder, judge, out, advance, pool)
    told, where = manifest["annotation"], str(out or folder)
    tables = [
        metrics_table(f"grader and labels, {split} split", figures)
        for split, figures in told["agreement"].items()
    ]
    done = f"{where}: {told['frames']} frames annotated by {told['grader'][:16]}"
    tell({"out": where, "digest": manifest["digest"], **told}, as_json, *tables, done)
