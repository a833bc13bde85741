"""The command `racines study leakage`. Heavy imports stand inside, so that --help is instant."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from racines_data.cli import options as opt


def leakage(
    root: opt.Root = None,
    out: opt.Report = Path("models/runs/leakage"),
    samples: Annotated[int, typer.Option(min=2, help="Test frames looked up.")] = 2000,
    seed: opt.DrawSeed = 0,
    as_json: opt.AsJson = False,
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
    from racines_models.cli.output import ranged

    splits = content["splits"].values()
    rows = [
        ("test frames", *(f"{each['ssim']['n']}" for each in splits)),
        ("frames to look up", *(f"{each['train']}" for each in splits)),
        ("SSIM", *(ranged(each["ssim"]) for each in splits)),
        ("PSNR, dB", *(ranged(each["psnr"]) for each in splits)),
    ]
    shown = {"position_mm": "median mm", "rotation_deg": "median degrees", "seconds": "median s"}
    for key, title in shown.items():
        rows.append((f"{title} away", *(_number(each[key]) for each in splits)))
    rows.append(("of the same sweep", *(f"{each['same_trajectory']:.1%}" for each in splits)))
    console = Console()
    head = ("split by", *content["splits"])
    console.print(console_table(head, rows, "nearest-pose retrieval"))
    gain = ", ".join(f"{k.upper()} {ranged(v)}" for k, v in content["gain"].items())
    console.print(f"what the split by frame adds: {gain}", soft_wrap=True, highlight=False)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
