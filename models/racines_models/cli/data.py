"""What models add to `racines data`: annotate and leakage. Heavy imports stand inside."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

Root = Annotated[Path | None, typer.Argument(help="Folder of the dataset.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print figures as JSON on stdout.")]


def register(data: typer.Typer) -> None:
    """Add `annotate` and `leakage` to `racines data`."""
    data.command("annotate")(annotate)
    data.command("leakage")(leakage)


def annotate(
    root: Root = None,
    grader: Annotated[Path, typer.Option(help="Folder of the grader's run.")] = Path(
        "models/runs/grader"
    ),
    out: Annotated[
        Path | None, typer.Option(help="Folder of the annotated dataset.  [default: ROOT itself]")
    ] = None,
    device: Annotated[str, typer.Option(help="cpu, cuda or auto.")] = "auto",
    as_json: AsJson = False,
) -> None:
    """Write a grader's view and grade of every frame into view_predicted and grade_predicted."""
    from racines_data.manifest import default_root, read_manifest
    from racines_data.progress import image_counter
    from racines_models.cli.output import show_metrics
    from racines_models.generators.base import resolve_device
    from racines_models.judges.grader.annotate import annotate as annotate_dataset
    from racines_models.judges.grader.model import Grader

    folder = default_root(root)
    total = read_manifest(folder)["counts"]["frames"]
    judge = Grader.load(grader, resolve_device(device))
    with image_counter("annotating", total, hidden=as_json) as advance:
        manifest = annotate_dataset(folder, judge, out, advance)
    told = manifest["annotation"]
    if as_json:
        typer.echo(json.dumps({"out": str(out or folder), "digest": manifest["digest"], **told}))
        return
    for split, figures in told["agreement"].items():
        show_metrics(f"grader and labels, {split} split", figures)
    typer.echo(f"{out or folder}: {told['frames']} frames annotated by {told['grader'][:16]}")


def leakage(
    root: Root = None,
    out: Annotated[Path, typer.Option(help="Writes OUT.json and OUT.png.")] = Path(
        "models/runs/leakage"
    ),
    samples: Annotated[int, typer.Option(min=2, help="Test frames looked up.")] = 2000,
    seed: Annotated[int, typer.Option(help="Draws the random split of frames.")] = 0,
    as_json: AsJson = False,
) -> None:
    """Show what a random split of frames would have scored beside the split by trajectories."""
    from racines_data.files import write_json
    from racines_data.manifest import default_root
    from racines_data.progress import image_counter
    from racines_data.store.frames import open_store
    from racines_models.studies.leakage import LeakageConfig, measure_leakage

    store = open_store(default_root(root))
    config = LeakageConfig(samples, seed)
    total = 2 * min(samples, len(store.split_indices("test")))
    held = store.manifest.get("held_out_session")
    if held is not None:
        total += min(samples, store.manifest["counts"]["sessions"][held])
    with image_counter("leakage", total, hidden=as_json) as advance:
        result = measure_leakage(store, config, advance)
    _write_picture(out.with_suffix(".png"), result)
    write_json(out.with_suffix(".json"), result.content)
    if as_json:
        typer.echo(json.dumps(result.content))
        return
    _show_leakage(result.content)
    typer.echo(f"{out}.json, {out}.png (truth; retrieved by trajectory split; by frame split)")


def _write_picture(path: Path, result: Any) -> None:
    from racines_models.pictures import pick_columns, write_strip

    frames = result.retrievals["trajectory"].sample.frames
    columns = pick_columns(frames.views, frames.grades)
    rows = [result.retrievals[split].images[columns] for split in ("trajectory", "frame")]
    write_strip(path, [frames.images[columns], *rows])


def _show_leakage(content: dict[str, Any]) -> None:
    from rich.console import Console

    from racines_data.tables import console_table

    splits = content["splits"].values()
    rows = [
        ("test frames", *(f"{each['ssim']['n']}" for each in splits)),
        ("frames to look up", *(f"{each['train']}" for each in splits)),
        ("SSIM", *(_ranged(each["ssim"]) for each in splits)),
        ("PSNR, dB", *(_ranged(each["psnr"]) for each in splits)),
    ]
    shown = {"position_mm": "median mm", "rotation_deg": "median degrees", "seconds": "median s"}
    for key, title in shown.items():
        rows.append((f"{title} away", *(_number(each[key]) for each in splits)))
    rows.append(("of the same sweep", *(f"{each['same_trajectory']:.1%}" for each in splits)))
    console = Console()
    head = ("split by", *content["splits"])
    console.print(console_table(head, rows, "nearest-pose retrieval"))
    gain = ", ".join(f"{k.upper()} {_ranged(v)}" for k, v in content["gain"].items())
    console.print(f"what the split by frame adds: {gain}", soft_wrap=True, highlight=False)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _ranged(figure: dict[str, Any]) -> str:
    if figure["low"] is None:
        return f"{figure['value']:.4g}"
    return f"{figure['value']:.3g} ({figure['low']:.3g} to {figure['high']:.3g})"
