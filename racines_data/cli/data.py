"""The commands `racines data …`. Heavy imports stand inside, so that --help is instant."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from racines_data.errors import RacinesError

data = typer.Typer(no_args_is_help=True, help="Build and check datasets.")

Params = Annotated[Path | None, typer.Option(help="Params file; its `data` section is used.")]
Profile = Annotated[
    str | None,
    typer.Option(help="Packaged settings: smoke, default, reference, paper or abdomen."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print figures as JSON on stdout.")]


@data.command()
def build(
    source: Annotated[str | None, typer.Option(help="phantom, tracked, or another's name.")] = None,
    inputs: Annotated[
        list[Path] | None, typer.Option("--input", help="Input file; repeat for several.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder of the dataset.")] = Path("data/racines"),
    workers: Annotated[int | None, typer.Option(min=1, help="Worker processes.")] = None,
    frames: Annotated[int | None, typer.Option(min=1, help="Frames to acquire.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of acquisition and splits.")] = None,
    strict: Annotated[bool, typer.Option(help="Stop at the first refused input.")] = False,
    params: Params = None,
    profile: Profile = None,
    as_json: AsJson = False,
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
    from racines_data.config import read_params, section

    start = time.perf_counter()
    if params is None and profile is None and Path("params.yaml").is_file():
        params = Path("params.yaml")
    values = section(read_params(params, profile), "data")
    given = {"source": source, "workers": workers, "frames": frames, "seed": seed}
    values |= {key: value for key, value in given.items() if value is not None}
    if strict:
        values["strict"] = True
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


@data.command()
def validate(
    root: Annotated[Path | None, typer.Argument(help="Folder of the dataset.")] = None,
    against: Annotated[
        Path | None, typer.Option(help="Another build that should be the same version.")
    ] = None,
    workers: Annotated[int, typer.Option(min=1, help="Processes for a large dataset.")] = 2,
    as_json: AsJson = False,
) -> None:
    """Check files, digests, rows, splits, copies and statistics; exit 1 if anything is wrong."""
    from racines_data.manifest import default_root
    from racines_data.validate.report import print_validation
    from racines_data.validate.run import to_json
    from racines_data.validate.run import validate as check

    result = check(default_root(root), against, workers, progress=not as_json)
    if as_json:
        typer.echo(json.dumps(to_json(result)))
    else:
        print_validation(result)
    if not result.ok:
        broken = "; ".join(
            f"{each.name}: {each.detail}" for each in result.checks if each.binding and not each.ok
        )
        raise RacinesError(f"{default_root(root)}: not valid: {broken}")
