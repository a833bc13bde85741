"""Commands: export generator, weights, poses, predictions. Heavy imports stand inside."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import check_ending, given, read_settings
from racines_models.cli.device import Device

if TYPE_CHECKING:
    from racines_models.exchange.predictions.file import Task


def export_generator(
    name: Annotated[str, typer.Argument(help="A registered generator, or module:Class.")],
    out: opt.OutFile,
    run: opt.Trained = None,
    as_json: opt.AsJson = False,
) -> None:
    """Write a trained generator as one ONNX file, where its method allows."""
    from racines_models.cli.output import tell
    from racines_models.exchange.onnx import generator as onnx
    from racines_models.registry import open_generator

    check_ending(out, ".onnx")
    made = onnx.export_generator(open_generator(name, run), out)
    tell(made, as_json, f"{out}: {made['bytes']:,} bytes, opset {made['opset']}")


def export_weights(
    run: Annotated[Path, typer.Argument(help="Folder of a trained run.")],
    out: opt.OwnOut = None,
    as_json: opt.AsJson = False,
) -> None:
    """Copy a run's weights in half precision, with hashes and how they were trained.

    They go to models/weights/NAME, or --out.
    """
    from racines_models.cli.output import tell
    from racines_models.weights import publish

    folder = out or Path("models/weights") / run.resolve().name
    files = publish(run, folder)["weights_files"]["files"]
    lines = [
        f"{folder / name}: {each['bytes'] / 1e6:.2f} MB, sha256 {each['sha256'][:12]}…"
        for name, each in files.items()
    ]
    tell({"out": str(folder), "files": files}, as_json, *lines)


def export_poses(
    out: opt.OutFile,
    data: opt.Data = opt.DATA,
    split: opt.OneSplit = None,
    samples: opt.Samples = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    as_json: opt.AsJson = False,
) -> None:
    """Write the poses that generators are scored on, for a program outside to draw."""
    from racines_models.cli.output import tell
    from racines_models.exchange.predictions.file import POSES, write_poses

    check_ending(out, ".parquet")
    task = _task(data, split, samples, params, profile)
    rows = write_poses(out, task)
    made = {"out": str(out), "rows": rows, **task.metadata(POSES)}
    tell(made, as_json, f"{out}: {rows} rows")


def export_predictions(
    name: Annotated[
        str, typer.Argument(help="A registered generator, module:Class, FILE.onnx or FILE.parquet.")
    ],
    out: opt.OutFile,
    data: opt.Data = opt.DATA,
    run: opt.Trained = None,
    split: opt.OneSplit = None,
    samples: opt.Samples = None,
    text: Annotated[str, typer.Option(help="Free text kept in the file.")] = "",
    params: opt.Params = None,
    profile: opt.Profile = None,
    device: Device = "auto",
    as_json: opt.AsJson = False,
) -> None:
    """Draw the poses that generators are scored on and write the images to a file."""
    from racines_data.progress import image_counter
    from racines_models.cli.output import tell
    from racines_models.exchange.predictions.file import PREDICTIONS, write_predictions
    from racines_models.registry import open_generator

    check_ending(out, ".parquet")
    task = _task(data, split, samples, params, profile)
    generator: Any = open_generator(name, run, device, store=task.store, split=task.split)
    total = len(task.sample.frames.index) * len(task.seeds)
    with image_counter(f"drawing {generator.name}", total, hidden=as_json) as advance:
        rows = write_predictions(out, task, generator, generator.name, text, advance)
    made = {"out": str(out), "rows": rows, **task.metadata(PREDICTIONS)}
    tell(made, as_json, f"{out}: {rows} rows")


def _task(
    data: Path, split: str | None, samples: int | None, params: Path | None, profile: str | None
) -> "Task":
    from racines_data.config import fill, section
    from racines_data.store.frames import open_store
    from racines_models.exchange.predictions.file import Task
    from racines_models.sample import take_sample
    from racines_models.scores.scoring import ScoresConfig

    settings = section(read_settings(params, profile), "scores")
    settings |= given(split=split, samples=samples)
    config = fill(ScoresConfig, settings, "scores")
    store = open_store(data)
    sample = take_sample(store, config.split, config.samples)
    return Task(store, sample, config.split, tuple(config.seeds))
