"""The command `racines data annotate`. Heavy imports stand inside, so that --help is instant."""

import json

import typer

from racines_data.cli import options as opt
from racines_models.cli.device import Device


def annotate(
    root: opt.Root = None,
    grader: opt.Grader = opt.GRADER,
    out: opt.OwnOut = None,
    device: Device = "auto",
    as_json: opt.AsJson = False,
) -> None:
    """Write a grader's view and grade of every frame into view_predicted and grade_predicted.

    The dataset itself is written anew, or a copy of it at --out.
    """
    from racines_data.manifest import default_root, read_manifest
    from racines_data.progress import image_counter
    from racines_models.cli.output import show_metrics
    from racines_models.judges.grader.annotate import annotate as annotate_dataset
    from racines_models.judges.grader.model import Grader

    folder = default_root(root)
    total = read_manifest(folder)["counts"]["frames"]
    judge = Grader.load(grader or opt.GRADER, device)
    with image_counter("annotating", total, hidden=as_json) as advance:
        manifest = annotate_dataset(folder, judge, out, advance)
    told = manifest["annotation"]
    if as_json:
        typer.echo(json.dumps({"out": str(out or folder), "digest": manifest["digest"], **told}))
        return
    for split, figures in told["agreement"].items():
        show_metrics(f"grader and labels, {split} split", figures)
    typer.echo(f"{out or folder}: {told['frames']} frames annotated by {told['grader'][:16]}")
