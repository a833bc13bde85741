"""Commands: export generator, weights, poses, predictions. Heavy imports stand inside."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import check_ending, given, read_settings
from racines_data.errors import RacinesError
from racines_models.cli.device import Device

if TYPE_CHECKING:
    from racines_models.exchange.predictions.file import Task

REFERENCE = Path("models/runs/scores/reference")
"""Where what is known of the frames alone is kept; as `racines eval generator` does."""


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
    form: Annotated[
        str, typer.Option("--format", help="float16, or int8: half of it again, coarser.")
    ] = "float16",
    as_json: opt.AsJson = False,
) -> None:
    """Copy a run's weights in fewer bits, with hashes and how they were trained.

    They go to models/weights/NAME, or --out.
    """
    from racines_models.cli.output import tell
    from racines_models.weights import publish

    folder = out or Path("models/weights") / run.resolve().name
    files = publish(run, folder, form)["weights_files"]["files"]
    lines = [
        f"{folder / name}: {each['bytes'] / 1e6:.2f} MB, sha256 {each['sha256'][:12]}…"
        for name, each in files.items()
    ]
    tell({"out": str(folder), "files": files}, as_json, *lines)


def export_poses(
    out: opt.OutFile,
    tier: opt.Tier = None,
    patients: opt.Patients = None,
    data: opt.Data = opt.DATA,
    split: opt.OneSplit = None,
    samples: opt.Samples = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    as_json: opt.AsJson = False,
) -> None:
    """Write the poses that generators are scored on, for a program outside to draw.

    With --tier patients they are those asked of --patients of the split, and OUT-scouts.parquet has
    the scout of each.
    """
    from racines_models.cli.output import tell
    from racines_models.exchange.predictions.file import POSES, write_poses
    from racines_models.exchange.predictions.scouts import write_scouts
    from racines_models.registry import on_patients

    check_ending(out, ".parquet")
    if on_patients(tier):
        task = _asked_task(data, samples, split, patients, params, profile, as_json)
        scouts = out.with_name(f"{out.stem}-scouts.parquet")
        rows, frames = write_poses(out, task), write_scouts(scouts, task)
        made = {"scouts": str(scouts), "frames": frames}
        lines = [f"{out}: {rows} rows", f"{scouts}: {frames} rows"]
    else:
        _check_no_patients(patients)
        task = _task(data, split, samples, params, profile)
        rows, made = write_poses(out, task), {}
        lines = [f"{out}: {rows} rows"]
    made = {"out": str(out), "rows": rows, **task.metadata(POSES), **made}
    tell(made, as_json, *lines)


def export_predictions(
    name: Annotated[
        str, typer.Argument(help="A registered generator, module:Class, FILE.onnx or FILE.parquet.")
    ],
    out: opt.OutFile,
    tier: opt.Tier = None,
    patients: opt.Patients = None,
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
    """Draw the poses that generators are scored on and write the images to a file.

    With --tier patients a generator is shown the scout of each of --patients of the split first.
    """
    from racines_data.progress import image_counter
    from racines_models.cli.output import tell
    from racines_models.exchange.predictions.file import PREDICTIONS, write_predictions
    from racines_models.registry import on_patients, open_generator

    check_ending(out, ".parquet")
    if on_patients(tier):
        task = _asked_task(data, samples, split, patients, params, profile, as_json)
        generator: Any = _adapting(name, run, device, task, read_settings(params, profile))
    else:
        _check_no_patients(patients)
        task = _task(data, split, samples, params, profile)
        generator = open_generator(name, run, device, store=task.store, split=task.split)
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


def _asked_task(
    data: Path, samples: int | None, split: str | None, patients: int | None,
    params: Path | None, profile: str | None, hidden: bool,
) -> "Task":  # fmt: skip
    """Return what is asked of patients, by the settings and what the command line gives."""
    from racines_data.config import fill, section
    from racines_data.progress import progress_bar
    from racines_data.store.asked import AskedStore
    from racines_models.exchange.predictions.file import Task
    from racines_models.scores.on_patients import PatientScoresConfig, asked_sample

    for option, there in (("--data", data != opt.DATA), ("--samples", samples)):
        if there:
            raise RacinesError(f"{option} is not for --tier patients: leave it out")
    settings = section(read_settings(params, profile), "patient_scores")
    settings |= given(split=split, patients=patients)
    config = fill(PatientScoresConfig, settings, "patient_scores")
    with progress_bar(not hidden, "patients") as bar:
        task, cache = bar.add_task("scouts", total=config.patients), REFERENCE
        asked = AskedStore(
            config.split, config.patients, config.seed, cache, lambda n: bar.advance(task, n)
        )
    return Task(asked, asked_sample(asked), config.split, (config.seed,))


def _adapting(
    name: str, run: Path | None, device: str, task: "Task", values: dict[str, Any]
) -> Any:
    """Return a generator, the first training alone, as it draws what is asked of patients."""
    from racines_data.config import section
    from racines_models.registry import generator_class, is_predictions, weights_folder
    from racines_models.scores.on_patients import OnPatients, check_named, open_for_patients

    assert task.asked is not None
    check_named(name)
    if is_predictions(name):
        return open_for_patients(name, run, asked=task.asked)[0]
    title = generator_class(name).name
    folder = weights_folder(name, run)
    own = section(values, "patient_generators").get(title)
    made = open_for_patients(name, folder, device=device, settings=own)[0]
    return OnPatients(made, task.asked, title)


def _check_no_patients(patients: int | None) -> None:
    if patients:
        raise RacinesError("--patients needs --tier patients")
