"""The command `racines study realism`. Heavy imports stand inside, so that --help is instant."""

from collections.abc import Callable
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import given, read_settings
from racines_data.errors import RacinesError
from racines_data.terminal import say
from racines_models.cli.device import Device
from racines_models.cli.output import tell

if TYPE_CHECKING:
    from rich.table import Table

    from racines_models.scores.features import Extractor
    from racines_models.studies.realism.report import RealFrames, RealismConfig, Simulated

Real = Annotated[Path | None, typer.Option(help="Parquet of real frames. Default: realism.real.")]


Patients = Annotated[
    str | None,
    typer.Option(help="Only the patients of one list: tuning or reporting.  [default: all]"),
]


class World(StrEnum):
    """Whose frames are held beside real ones."""

    phantom = "phantom"
    patients = "patients"


def realism(
    real: Real = None,
    patients: Patients = None,
    world: Annotated[
        World, typer.Option(help="Frames of a dataset (phantom), or of patients drawn anew.")
    ] = World.phantom,
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
    """Hold simulated A4C frames beside real ones: those of a dataset, or patients drawn anew.

    Of a dataset, one heart and many, where it has them (OUT, OUT-multi_phantom). Of patients, still
    hearts and beating ones (OUT-patients, OUT-beating).
    """
    from racines_data.files import write_json
    from racines_models.scores.features import InceptionFeatures
    from racines_models.studies.realism.patients import patients_of
    from racines_models.studies.realism.report import not_compared, read_real

    config, path = realism_settings(real, frames, params, profile)
    if patients is not None:
        patients_of(patients)  # refused before a file is looked for
    sets = _sets(world, data, config)
    outs = {
        name: out.with_name(out.name + ("" if name == "frames" else f"-{name}")) for name in sets
    }
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
        simulated = sets[name]()
        if simulated is None:
            reports[name] = not_compared(name, f"the dataset has no config {name}")
            write_json(report.with_suffix(".json"), reports[name])
            report.with_suffix(".png").unlink(missing_ok=True)  # of an earlier dataset
            continue
        reports[name] = _compare(images, simulated, config, extractor, report, as_json)
    tell(reports, as_json)


def _sets(
    world: World, data: Path, config: "RealismConfig"
) -> "dict[str, Callable[[], Simulated | None]]":
    """Return by name what makes each set of simulated frames; None where the dataset has none."""
    from racines_data.manifest import MULTI_PHANTOM, read_manifest, store_name
    from racines_data.store.frames import open_store
    from racines_models.studies.realism.patient_frames import CONFIGS, of_patients
    from racines_models.studies.realism.report import of_store

    def of_config(name: str) -> "Simulated | None":
        if name != "frames" and store_name(name) not in read_manifest(data)["files"]:
            return None
        return of_store(open_store(data, name), config)

    if world is World.patients:
        return {name: partial(of_patients, config, beats) for name, beats in CONFIGS.items()}
    return {name: partial(of_config, name) for name in ("frames", MULTI_PHANTOM)}


def _compare(
    real: "RealFrames",
    simulated: "Simulated",
    config: "RealismConfig",
    extractor: "Extractor",
    report: Path,
    as_json: bool,
) -> dict[str, Any]:
    """Write the report on one set of simulated frames, and a strip of both."""
    import torch

    from racines_data.files import write_json
    from racines_data.progress import image_counter
    from racines_models.pictures import COLUMNS, write_strip
    from racines_models.studies.realism.report import compare_with_real

    total = min(len(real.images), 2 * config.frames) + config.frames
    with image_counter(f"realism of {simulated.told['config']}", total, as_json) as advance:
        result = compare_with_real(real, simulated, config, extractor, advance)
    places = 2 * torch.arange(min(COLUMNS, len(result.phantom))) + 1
    rows = [each[places * len(each) // (2 * len(places))] for each in (result.real, result.phantom)]
    write_strip(report.with_suffix(".png"), rows)
    write_json(report.with_suffix(".json"), result.content)
    if not as_json:
        written = f"{report}.json, {report}.png (above real, below simulated)"
        tell(result.content, False, _table(result.content), written)
    return result.content


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
