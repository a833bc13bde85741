"""The command `racines data import`. Heavy imports stand inside, so that --help is instant."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.settings import given, overrides, read_settings
from racines_data.errors import RacinesError

if TYPE_CHECKING:
    from racines_data.sources.base import Source

_SHOWN = 20


def import_(
    inputs: Annotated[list[Path], typer.Argument(help="Folder or files to import.")],
    source: Annotated[
        str, typer.Option(help="release, cactus, tracked, or another's name.")
    ] = "release",
    out: opt.Out = Path("data/imported"),
    settings: opt.Set = None,
    strict: opt.Strict = False,
    max_refused: Annotated[
        float | None, typer.Option(min=0, max=1, help="Largest share of frames to refuse.")
    ] = None,
    workers: opt.Workers = None,
    seed: opt.Seed = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    as_json: opt.AsJson = False,
) -> None:
    """Import recordings as a dataset, and say by kind what could not be used.

    A source has settings of its own, such as --set unit=mm. What is refused or flagged stands, file
    by file, in import_report.parquet of the dataset.
    """
    from racines_data.build.dataset import build, make_source, read_data_section
    from racines_data.config import section

    values = section(read_settings(params, profile), "data") | given(
        source=source, workers=workers, seed=seed, max_refused=max_refused, strict=strict or None
    )
    config, sections = read_data_section(values)
    own = sections.get(config.source, {}) | overrides(settings)
    made = make_source(config, own, inputs)
    if hasattr(made, "progress"):
        setattr(made, "progress", not as_json)  # noqa: B010
    try:
        manifest = build(made, out, config, progress=not as_json)
    except RacinesError as error:
        _print_refusal(made, error, as_json)
        raise
    if as_json:
        keys = ("source", "version", "digest", "recipe_digest", "counts", "report")
        summary = {key: manifest[key] for key in keys}
        typer.echo(json.dumps({"out": str(out), **summary, **_report(made)}))
    else:
        _print_import(made, out, manifest)


def _report(source: "Source") -> dict[str, Any]:
    from racines_data.sources.folder import count_kinds

    findings = [vars(finding) for finding in source.report]
    return {"kinds": count_kinds(source.report), "findings": findings}


def _print_refusal(source: "Source", error: RacinesError, as_json: bool) -> None:
    if as_json:
        typer.echo(json.dumps({"out": None, "error": str(error), **_report(source)}))
    elif source.report:
        _print_kinds(source, "nothing was imported")


def _print_import(source: "Source", out: Path, manifest: dict[str, Any]) -> None:
    counts = manifest["counts"]
    splits = ", ".join(f"{name} {count['frames']}" for name, count in counts["splits"].items())
    typer.echo(
        f"{out}: {manifest['source']} {manifest['version']}, {counts['frames']} frames in "
        f"{counts['trajectories']} trajectories ({splits})\ncontent {manifest['digest']}"
    )
    refused, flagged = manifest["report"]["refused_frames"], manifest["report"]["flagged"]
    if source.report:
        _print_kinds(source, f"{refused} frames refused, {flagged} findings flagged")
    else:
        typer.echo("every file is sound")


def _print_kinds(source: "Source", headline: str) -> None:
    typer.echo(headline)
    for kind, count in _report(source)["kinds"].items():
        typer.echo(f"  {count:6d}  {kind}")
    for finding in source.report[:_SHOWN]:
        verdict = "refused" if finding.refused else "flagged"
        item = f" {finding.item}" if finding.item else ""
        typer.echo(f"{verdict}: {finding.file}{item}: {finding.reason}")
    if len(source.report) > _SHOWN:
        typer.echo(
            f"… and {len(source.report) - _SHOWN} more: see import_report.parquet, or --json"
        )
