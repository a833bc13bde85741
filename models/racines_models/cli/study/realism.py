"""The command `racines study realism`. Heavy imports stand inside, so that --help is instant."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.errors import RacinesError
from racines_models.cli.device import Device
from racines_models.cli.study.real import Real, no_real, realism_settings

if TYPE_CHECKING:
    from racines_models.scores.features import Extractor
    from racines_models.studies.realism.report import RealFrames, RealismConfig

CONFIGS = ("frames", "multi_phantom")


def realism(
    real: Real = None,
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
    from racines_models.scores.inception import InceptionFeatures
    from racines_models.studies.realism.report import read_real

    config, path = realism_settings(real, frames, params, profile)
    if path is None or (optional and not path.is_file()):
        _without_real(path, out, optional)
        return
    frames_real, extractor = read_real(path), InceptionFeatures(device)
    reports = {
        name: _realism(frames_real, data, name, config, _named(out, name), extractor, as_json)
        for name in CONFIGS
    }
    if as_json:
        typer.echo(json.dumps(reports))


def _named(out: Path, config: str) -> Path:
    return out if config == "frames" else out.with_name(f"{out.name}-{config}")


def _without_real(path: Path | None, out: Path, optional: bool) -> None:
    from racines_data.files import write_json
    from racines_models.studies.realism.report import not_compared

    if not optional:
        raise RacinesError(no_real(path))
    typer.echo(f"racines: {no_real(path)}", err=True)
    reason = "the named file of real frames is absent" if path else "no real frames named"
    for name in CONFIGS:
        write_json(_named(out, name).with_suffix(".json"), not_compared(name, reason))


def _realism(
    real: "RealFrames",
    data: Path,
    name: str,
    config: "RealismConfig",
    out: Path,
    extractor: "Extractor",
    hidden: bool,
) -> dict[str, Any]:
    """Compare one config of the dataset, write its report and picture, and show the figures."""
    import torch

    from racines_data.files import write_json
    from racines_data.manifest import read_manifest, store_name
    from racines_data.progress import image_counter
    from racines_data.store.frames import open_store
    from racines_models.cli.output import show_realism
    from racines_models.pictures import COLUMNS, write_strip
    from racines_models.studies.realism.report import compare_with_real, not_compared

    if name != "frames" and store_name(name) not in read_manifest(data)["files"]:
        content = not_compared(name, f"the dataset has no config {name}")
        write_json(out.with_suffix(".json"), content)
        out.with_suffix(".png").unlink(missing_ok=True)  # of an earlier dataset
        return content
    total = min(len(real.images), 2 * config.frames) + config.frames
    with image_counter(f"realism of {name}", total, hidden) as advance:
        result = compare_with_real(real, open_store(data, name), config, extractor, advance)
    rows = []
    for images in (result.real, result.phantom):
        count = min(COLUMNS, len(result.phantom))
        rows.append(images[(2 * torch.arange(count) + 1) * len(images) // (2 * count)])
    write_strip(out.with_suffix(".png"), rows)
    write_json(out.with_suffix(".json"), result.content)
    if not hidden:
        show_realism(result.content)
        typer.echo(f"{out}.json, {out}.png (above real, below phantom)")
    return result.content
