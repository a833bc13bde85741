"""The command `racines data build`. Heavy imports stand inside, so that --help is instant."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.settings import given, read_settings
from racines_data.errors import RacinesError


def build(
    source: Annotated[str | None, typer.Option(help="phantom, tracked, or another's name.")] = None,
    inputs: Annotated[
        list[Path] | None, typer.Option("--input", help="Input file; repeat for several.")
    ] = None,
    out: opt.Out = opt.DATA,
    workers: opt.Workers = None,
    frames: Annotated[int | None, typer.Option(min=1, help="Frames to acquire.")] = None,
    seed: opt.Seed = None,
    strict: opt.Strict = False,
    params: opt.Params = None,
    profile: opt.Profile = None,
    as_json: opt.AsJson = False,
) -> None:
    """Acquire or import a dataset, and write it as shards, a training store and a card."""
    import time

    from racines_data.build.dataset import build as build_dataset
    from racines_data.build.dataset import (
        make_multi_phantom,
        make_source,
        peak_memory,
        read_data_section,
    )
    from racines_data.config import section

    start = time.perf_counter()
    values = section(read_settings(params, profile), "data")
    values |= given(source=source, workers=workers, frames=frames, seed=seed, strict=strict or None)
    config, sections = read_data_section(values)
    if frames is not None:
        _check_frames_wanted(config.source)
    made = make_source(config, sections.get(config.source), inputs or [])
    many = make_multi_phantom(made, config, sections.get("multi_phantom"))
    manifest = build_dataset(made, out, config, progress=not as_json, many=many)
    findings = [vars(finding) for finding in made.report]
    if as_json:
        keys = ("source", "version", "digest", "recipe_digest", "tag", "counts", "report")
        summary = {key: manifest[key] for key in keys}
        summary["multi_phantom"] = manifest.get("multi_phantom")
        usage = {
            "seconds": round(time.perf_counter() - start, 2),
            "peak_memory": peak_memory(config.workers),
        }
        typer.echo(json.dumps({"out": str(out), **summary, "findings": findings, **usage}))
    else:
        _print_build(out, manifest, findings)


def _check_frames_wanted(source: str) -> None:
    import dataclasses

    from racines_data.sources.base import source_class

    if "frames" not in {field.name for field in dataclasses.fields(source_class(source).Config)}:
        raise RacinesError(f"--frames: source {source} has the frames of its inputs; leave it out")


def _print_build(out: Path, manifest: dict[str, Any], findings: list[dict[str, Any]]) -> None:
    from rich.console import Console

    console = Console()
    counts = manifest["counts"]
    splits = ", ".join(f"{name} {count['frames']}" for name, count in counts["splits"].items())
    console.print(
        f"{out}: {manifest['source']} {manifest['version']}, {counts['frames']} frames in "
        f"{counts['trajectories']} trajectories ({splits})\ncontent {manifest['digest']}\n"
        f"recipe  {manifest['recipe_digest']}",
        soft_wrap=True,
        highlight=False,
    )
    for finding in findings[:20]:
        verdict = "refused" if finding["refused"] else "flagged"
        text = f"{verdict}: {finding['file']} {finding['item']}: {finding['reason']}"
        console.print(text, soft_wrap=True, highlight=False, markup=False)
    if len(findings) > 20:
        console.print(f"… and {len(findings) - 20} more: see import_report.parquet")
