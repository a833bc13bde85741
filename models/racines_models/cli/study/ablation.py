"""The command `racines study ablation`. Heavy imports stand inside, so that --help is instant."""

import json
from pathlib import Path
from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_data.errors import RacinesError
from racines_models.cli.device import Device
from racines_models.cli.study.real import Real, no_real, realism_settings


def ablation(
    real: Real = None,
    hearts: Annotated[int, typer.Option(min=1, help="Hearts 1 … of the population.")] = 12,
    poses: Annotated[int, typer.Option(min=2, help="Poses of each heart.")] = 8,
    variant: Annotated[
        list[str] | None, typer.Option(help="Only this variant; repeat for several.")
    ] = None,
    out: opt.Report = Path("models/runs/ablation"),
    into: Annotated[
        Path | None, typer.Option(help="Report of study realism that takes the list up.")
    ] = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    device: Device = "auto",
    as_json: opt.AsJson = False,
) -> None:
    """Measure what each part of the phantom brings: KID to real frames without it.

    A report that is there goes on: the rows it has are kept.
    """
    from racines_data.files import write_atomic
    from racines_data.phantom import PhantomConfig
    from racines_data.progress import image_counter
    from racines_models.cli.output import show_ablation
    from racines_models.scores.inception import InceptionFeatures
    from racines_models.studies.ablation.run import (
        AblationConfig,
        Setting,
        ablate,
        draw_ablation,
        merge_into,
    )
    from racines_models.studies.ablation.variants import pick_variants
    from racines_models.studies.realism.report import read_real

    config, path = realism_settings(real, None, params, profile)
    if path is None:
        raise RacinesError(no_real(path))
    frames, variants = read_real(path), pick_variants(variant)
    setting = Setting(PhantomConfig(), AblationConfig(hearts, poses), config)
    total = 2 * len(variants) * hearts * poses + min(len(set(frames.patient)), 2 * config.frames)
    with image_counter("ablation", total, as_json) as advance:
        extractor = InceptionFeatures(device)
        content = ablate(frames, variants, setting, extractor, out.with_suffix(".json"), advance)
    write_atomic(out.with_suffix(".png"), draw_ablation(content))
    if into is not None:
        merge_into(into, content)
    if as_json:
        typer.echo(json.dumps(content))
        return
    show_ablation(content)
    typer.echo(f"{out}.json, {out}.png" + (f"; list in {into}" if into else ""))
