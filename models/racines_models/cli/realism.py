"""Commands: eval realism, eval ablation. Heavy imports stand inside."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racines_data.errors import RacinesError
from racines_models.cli.scores import (
    DATA,
    AsJson,
    Data,
    Device,
    Params,
    Profile,
    read_values,
)

if TYPE_CHECKING:
    from racines_models.scores.features import Extractor
    from racines_models.studies.realism.report import RealFrames, RealismConfig

Real = Annotated[Path | None, typer.Option(help="Parquet of real frames. Default: realism.real.")]
CONFIGS = ("frames", "multi_phantom")


def register(evaluate: typer.Typer) -> None:
    """Add `realism` and `ablation` to `racines eval`."""
    evaluate.command("realism")(realism)
    evaluate.command("ablation")(ablation)


def realism(
    real: Real = None,
    frames: Annotated[int | None, typer.Option(min=2, help="Default: realism.frames.")] = None,
    data: Data = DATA,
    out: Annotated[
        Path, typer.Option(help="Writes OUT.json, OUT.png and the same as OUT-multi_phantom.")
    ] = Path("models/runs/realism"),
    optional: Annotated[
        bool, typer.Option("--optional", help="Without real frames, say so and exit 0.")
    ] = False,
    params: Params = None,
    profile: Profile = None,
    device: Device = "auto",
    as_json: AsJson = False,
) -> None:
    """Hold the phantom's A4C frames beside real ones: one heart, and many where there are."""
    from racines_models.studies.realism.report import read_real

    config, path = _settings(real, frames, params, profile)
    if path is None or (optional and not path.is_file()):
        _without_real(path, out, optional)
        return
    frames_real, extractor = read_real(path), _extractor(device)
    reports = {
        name: _realism(frames_real, data, name, config, _named(out, name), extractor, as_json)
        for name in CONFIGS
    }
    if as_json:
        typer.echo(json.dumps(reports))


def ablation(
    real: Real = None,
    hearts: Annotated[int, typer.Option(min=1, help="Hearts 1 … of the population.")] = 12,
    poses: Annotated[int, typer.Option(min=2, help="Poses of each heart.")] = 8,
    variant: Annotated[
        list[str] | None, typer.Option(help="Only this variant; repeat for several.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Writes OUT.json and OUT.png; kept rows stay.")] = Path(
        "models/runs/ablation"
    ),
    into: Annotated[
        Path | None, typer.Option(help="Report of eval realism that takes the list up.")
    ] = None,
    params: Params = None,
    profile: Profile = None,
    device: Device = "auto",
    as_json: AsJson = False,
) -> None:
    """Measure what each part of the phantom brings: KID to real frames without it."""
    from racines_data.files import write_atomic
    from racines_data.phantom import PhantomConfig
    from racines_data.progress import image_counter
    from racines_models.cli.output import show_ablation
    from racines_models.studies.ablation.picture import draw_ablation
    from racines_models.studies.ablation.run import AblationConfig, Setting, ablate, merge_into
    from racines_models.studies.ablation.variants import pick_variants
    from racines_models.studies.realism.report import read_real

    config, path = _settings(real, None, params, profile)
    if path is None:
        raise RacinesError(_told(path))
    frames, variants = read_real(path), pick_variants(variant)
    setting = Setting(PhantomConfig(), AblationConfig(hearts, poses), config)
    total = 2 * len(variants) * hearts * poses + min(len(set(frames.patient)), 2 * config.frames)
    with image_counter("ablation", total, as_json) as advance:
        extractor = _extractor(device)
        content = ablate(frames, variants, setting, extractor, out.with_suffix(".json"), advance)
    write_atomic(out.with_suffix(".png"), draw_ablation(content))
    if into is not None:
        merge_into(into, content)
    if as_json:
        typer.echo(json.dumps(content))
        return
    show_ablation(content)
    typer.echo(f"{out}.json, {out}.png" + (f"; list in {into}" if into else ""))


def _settings(
    real: Path | None, frames: int | None, params: Path | None, profile: str | None
) -> "tuple[RealismConfig, Path | None]":
    """Return the section `realism`, and the file of real frames where one is named."""
    from racines_data.config import fill, section
    from racines_models.studies.realism.report import RealismConfig

    settings = section(read_values(params, profile), "realism")
    if frames is not None:
        settings["frames"] = frames
    config = fill(RealismConfig, settings, "realism")
    return config, real or (Path(config.real) if config.real else None)


def _extractor(device: str) -> "Extractor":
    from racines_models.scores.inception import InceptionFeatures

    return InceptionFeatures(device)


def _named(out: Path, config: str) -> Path:
    return out if config == "frames" else out.with_name(f"{out.name}-{config}")


def _told(path: Path | None) -> str:
    told = f"{path}: no such file" if path else "no real frames named"
    return f"{told}; give --real PATH.parquet (docs/scores.md): THE PHANTOM IS NOT COMPARED"


def _without_real(path: Path | None, out: Path, optional: bool) -> None:
    from racines_data.files import write_json
    from racines_models.studies.realism.report import not_compared

    if not optional:
        raise RacinesError(_told(path))
    typer.echo(f"racines: {_told(path)}", err=True)
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
