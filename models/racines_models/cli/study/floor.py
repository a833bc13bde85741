"""The command `racines study floor`. Heavy imports stand inside, so that --help is instant."""

import json
from pathlib import Path
from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_models.cli.device import Device


def floor(
    data: opt.Data = opt.DATA,
    out: opt.Report = Path("models/runs/floor"),
    sizes: Annotated[
        list[int] | None,
        typer.Option("--n", min=2, help="Frames of each half; repeat.  [default: 128 … 1024]"),
    ] = None,
    splits: Annotated[int, typer.Option(min=1, help="Random halvings.")] = 10,
    split: opt.Split = "test",
    seed: opt.DrawSeed = 0,
    grader: opt.Grader = None,
    cache: Annotated[Path, typer.Option(help="Folder that keeps features.")] = Path(
        "models/runs/scores/reference"
    ),
    device: Device = "auto",
    as_json: opt.AsJson = False,
) -> None:
    """Compare true frames with true frames: the FID and KID that a perfect generator would have.

    Two halves of a split that share no trajectory, at several n; by the features of Inception and
    of the grader, that of models/runs/grader if it is there.
    """
    from racines_data.files import write_atomic, write_json
    from racines_data.progress import image_counter
    from racines_data.store.frames import open_store
    from racines_models.cli.output import ranged
    from racines_models.judges.grader.model import Grader
    from racines_models.scores.features import Extractor, GraderFeatures
    from racines_models.scores.inception import InceptionFeatures
    from racines_models.studies.floor import FloorConfig, draw_floor, frames_needed, measure_floor

    extractors: dict[str, Extractor] = {"inception": InceptionFeatures(device)}
    grader = grader or (opt.GRADER if opt.GRADER.is_dir() else None)
    if grader is not None:
        extractors["grader"] = GraderFeatures(Grader.load(grader, device))
    config = FloorConfig(tuple(sizes or FloorConfig.sizes), splits, split, seed)
    store = open_store(data)
    total = len(frames_needed(store, config).trajectory)
    with image_counter("truth against truth", total, hidden=as_json) as advance:
        content = measure_floor(store, extractors, config, cache, advance)
    write_atomic(out.with_suffix(".png"), draw_floor(content))
    write_json(out.with_suffix(".json"), content)
    if as_json:
        typer.echo(json.dumps(content))
        return
    for name, rows in content["rows"].items():
        for row in rows:
            fid, kid = ranged(row["fid"]), ranged(row["kid"])
            typer.echo(f"{name}, n = {row['n']}: FID {fid}, KID {kid}")
    typer.echo(f"{out}.json, {out}.png")
