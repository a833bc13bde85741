"""The command `racines data import`. Heavy imports stand inside, so that --help is instant."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racines_data.cli.data import AsJson, Params, Profile, data
from racines_data.errors import RacinesError

if TYPE_CHECKING:
    from racines_data.build.dataset import DataConfig
    from racines_data.sources.base import Source

_SHOWN = 20


@data.command("import")
def import_(
    inputs: Annotated[list[Path], typer.Argument(help="Folder or files to import.")],
    source: Annotated[
        str, typer.Option(help="release, cactus, tracked, or another's name.")
    ] = "release",
    out: Annotated[Path, typer.Option(help="Folder of the dataset.")] = Path("data/imported"),
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="Setting of the source: unit=mm. Repeat it.")
    ] = None,
    strict: Annotated[bool, typer.Option(help="Stop at the first refused input.")] = False,
    max_refused: Annotated[
        float | None, typer.Option(min=0, max=1, help="Largest share of frames to refuse.")
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Worker processes.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the splits.")] = None,
    params: Params = None,
    profile: Profile = None,
    as_json: AsJson = False,
) -> None:
    """Import recordings as a dataset, and say by kind what could not be used.

    What is refused or flagged stands, file by file, in import_report.parquet of the dataset.
    """
    from racines_data.build.dataset import build, make_source

    given = {"source": source, "workers": workers, "seed": seed, "max_refused": max_refused}
    if strict:
        given["strict"] = True
    config, section = _read(given, params, profile)
    made = make_source(config, section | _settings(settings or []), inputs)
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


def _read(
    given: dict[str, Any], params: Path | None, profile: str | None
) -> tuple["DataConfig", dict[str, Any]]:
    """Return the builder's settings and those of the source, the command line's over the file's."""
    from racines_data.build.dataset import read_data_section
    from racines_data.config import read_params, section

    if params is None and profile is None and Path("params.yaml").is_file():
        params = Path("params.yaml")
    values = section(read_params(params, profile), "data")
    values |= {key: value for key, value in given.items() if value is not None}
    config, sections = read_data_section(values)
    return config, sections.get(config.source, {})


def _settings(pairs: list[str]) -> dict[str, Any]:
    import yaml

    values = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not equals:
            raise typer.BadParameter(f"{pair!r}: write NAME=VALUE", param_hint="--set")
        values[name] = yaml.safe_load(value)
    return values


def _report(source: "Source") -> dict[str, Any]:
    from racines_data.sources.release.kinds import count_kinds

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
