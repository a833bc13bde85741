"""Commands that vary one part at a time: study ablation, study conditioning. Imports inside."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.settings import read_settings, seed_of
from racines_data.errors import RacinesError
from racines_models.cli.device import Device
from racines_models.cli.study.realism import Real, no_real, realism_settings


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
    from racines_data.tables import console_table
    from racines_models.cli.output import ranged, tell
    from racines_models.scores.features import InceptionFeatures
    from racines_models.studies.ablation import run as study
    from racines_models.studies.realism.report import read_real

    config, path = realism_settings(real, None, params, profile)
    if path is None:
        raise RacinesError(no_real(path))
    frames, variants = read_real(path), study.pick_variants(variant)
    setting = study.Setting(PhantomConfig(), study.AblationConfig(hearts, poses), config)
    total = 2 * len(variants) * hearts * poses + min(len(set(frames.patient)), 2 * config.frames)
    with image_counter("ablation", total, as_json) as advance:
        extractor, report = InceptionFeatures(device), out.with_suffix(".json")
        content = study.ablate(frames, variants, setting, extractor, report, advance)
    write_atomic(out.with_suffix(".png"), study.draw_ablation(content))
    if into is not None:
        study.merge_into(into, content)
    rows = []
    for row in (content["base"], *content["ablation"]):
        change = ""
        if "change" in row:
            reach = f"({row['change_low']:+.4f} to {row['change_high']:+.4f})"
            change = f"{row['change']:+.4f} {reach}"
        rows.append((row["name"], ranged({"value": row["kid"], **row}), change))
    head = ("variant", "KID (range over splits)", "change (range over the same splits)")
    title = f"{content['view']}, {content['n']} frames a set, {content['splits']} splits"
    written = f"{out}.json, {out}.png" + (f"; list in {into}" if into else "")
    tell(content, as_json, console_table(head, rows, title), written)


def conditioning(
    name: Annotated[str, typer.Argument(help="A generator with conditioning and injection.")],
    data: opt.Data = opt.DATA,
    out: opt.OwnOut = None,
    images: Annotated[
        int | None, typer.Option(min=1, help="Training images of each variant; default: params'.")
    ] = None,
    frames: Annotated[int, typer.Option(min=2, help="Validation frames that judge.")] = 500,
    pose: opt.Pose = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    seed: opt.Seed = None,
    device: Device = "auto",
    as_json: opt.AsJson = False,
) -> None:
    """Train a generator four ways (Euler or continuous, concat or norm) and compare them.

    A pose regressor adds the error of the poses; all goes to models/runs/conditioning-NAME.
    """
    from racines_data.config import fill, section
    from racines_data.store.frames import open_store
    from racines_data.tables import console_table
    from racines_models.cli.output import tell
    from racines_models.judges.pose.regressor import PoseRegressor
    from racines_models.protocol import Run
    from racines_models.registry import generator_class
    from racines_models.studies.conditioning import run_ablation

    cls, values = generator_class(name), read_settings(params, profile)
    settings = section(values, ("generators", cls.name))
    config: Any = fill(cls.Config, settings, f"generators.{cls.name}")
    if images is not None:
        config = replace(config, training=replace(config.training, images=images))
    regressor = PoseRegressor.load(pose, device) if pose else None
    out = out or Path("models/runs") / f"conditioning-{cls.name}"
    run = Run(out, seed_of(values, seed), device, progress=not as_json)
    content = run_ablation(cls, config, open_store(data), run, frames, regressor)
    title = f"{content['generator']}, {content['n']} {content['split']} frames"
    figures = [key for key, value in content["variants"][0].items() if isinstance(value, float)]
    rows = [
        (row["conditioning"], row["injection"], *(f"{row[figure]:.4g}" for figure in figures))
        for row in content["variants"]
    ]
    head = ("conditioning", "injection", *figures)
    tell(content, as_json, console_table(head, rows, title, right=2))
