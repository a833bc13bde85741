"""The command `racines study realism`. Heavy imports stand inside, so that --help is instant."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import given, read_settings
from racines_data.errors import RacinesError
from racines_data.terminal import say
from racines_models.cli.device import Device

if TYPE_CHECKING:
    from rich.table import Table

    from racines_models.studies.realism.report import RealismConfig

Real = Annotated[Path | None, typer.Option(help="Parquet of real frames. Default: realism.real.")]


Patients = Annotated[
    str | None,
    typer.Option(help="Only the patients of one list: tuning or reporting.  [default: all]"),
]


def realism(
    real: Real = None,
    patients: Patients = None,
    frames: Annotated[int | None, typer.Option(min=2, help="Default: realism.frames.")] = None,
    data: opt.Data = opt.DATA,
    out: opt.Report = Path("models/runs/realism"),
    optional: Annotated[
        bool, typer.Option("--optional", help="Without real frames, say so and exit 0.")
    ] = False,
    params: opt.Params = None,
    profile: opt.Profile = None,
    device: Device = "auto",
    as_json: opt.AsJson = False,
) -> None:
    """Hold the phantom's A4C frames beside real ones: one heart, and many where there are.

    The report on many hearts goes to OUT-multi_phantom.
    """
    import torch

    from racines_data.files import write_json
    from racines_data.manifest import read_manifest, store_name
    from racines_data.progress import image_counter
    from racines_data.store.frames import open_store
    from racines_models.cli.output import tell
    from racines_models.pictures import COLUMNS, write_strip
    from racines_models.scores.features import InceptionFeatures
    from racines_models.studies.realism.patients import patients_of
    from racines_models.studies.realism.report import compare_with_real, not_compared, read_real

    config, path = realism_settings(real, frames, params, profile)
    if patients is not None:
        patients_of(patients)  # refused before a file is looked for
    outs = {"frames": out, "multi_phantom": out.with_name(f"{out.name}-multi_phantom")}
    if path is None or (optional and not path.is_file()):
        if not optional:
            raise RacinesError(no_real(path))
        say(f"racines: {no_real(path)}", err=True)
        reason = "the named file of real frames is absent" if path else "no real frames named"
        for name, report in outs.items():
            write_json(report.with_suffix(".json"), not_compared(name, reason))
        return
    images, extractor, reports = read_real(path, patients), InceptionFeatures(device), {}
    for name, report in outs.items():
        if name != "frames" and store_name(name) not in read_manifest(data)["files"]:
            reports[name] = not_compared(name, f"the dataset has no config {name}")
            write_json(report.with_suffix(".json"), reports[name])
            report.with_suffix(".png").unlink(missing_ok=True)  # of an earlier dataset
            continue
        total = min(len(images.images), 2 * config.frames) + config.frames
        with image_counter(f"realism of {name}", total, as_json) as advance:
            result = compare_with_real(images, open_store(data, name), config, extractor, advance)
        places = 2 * torch.arange(min(COLUMNS, len(result.phantom))) + 1
        sets = (result.real, result.phantom)
        rows = [each[places * len(each) // (2 * len(places))] for each in sets]
        write_strip(report.with_suffix(".png"), rows)
        reports[name] = result.content
        write_json(report.with_suffix(".json"), reports[name])
        if not as_json:
            written = f"{report}.json, {report}.png (above real, below phantom)"
            tell(reports[name], False, _table(reports[name]), written)
    tell(reports, as_json)


def realism_settings(
    real: Path | None, frames: int | None, params: Path | None, profile: str | None
) -> "tuple[RealismConfig, Path | None]":
    """Return the section `realism`, and the file of real frames where one is named."""
    from racines_data.config import fill, section
    from racines_models.studies.realism.report import RealismConfig

    settings = section(read_settings(params, profile), "realism") | given(frames=frames)
    config = fill(RealismConfig, settings, "realism")
    return config, real or (Path(config.real) if config.real else None)


def no_real(path: Path | None) -> str:
    """Return what is said where there are no real frames."""
    told = f"{path}: no such file" if path else "no real frames named"
    return f"{told}; give --real PATH.parquet (docs/scores.md): THE PHANTOM IS NOT COMPARED"


def _table(content: dict[str, Any]) -> "Table":
    from racines_data.tables import console_table
    from racines_models.cli.output import ranged

    rows = []
    for name, figure in content["figures"].items():
        ours, real = figure["phantom"], figure["real"]
        ratio = f"{ours['value'] / real['value']:.3g}" if real["low"] > 0 else "-"
        rows.append((name, ranged(ours), ranged(real), ratio))
    title = "{config}, {view}, {n} frames a set, {splits} splits".format(**content)
    return console_table(("figure", "phantom, real", "real, real", "ratio"), rows, title)
