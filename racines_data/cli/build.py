"""The commands `racines data build` and `racines data import`. Heavy imports stand inside."""

import time
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import given, overrides, read_settings
from racines_data.errors import RacinesError
from racines_data.terminal import say, say_json

if TYPE_CHECKING:
    from racines_data.sources.base import Finding

_SHOWN = 20
_KEYS = ("source", "version", "digest", "recipe_digest", "counts", "report")


def build(
    source: Annotated[
        str | None, typer.Option(help="phantom, patients, beating, tracked, or another's name.")
    ] = None,
    inputs: Annotated[
        list[Path] | None, typer.Option("--input", help="Input file; repeat for several.")
    ] = None,
    out: opt.Out = opt.DATA,
    workers: opt.Workers = None,
    frames: Annotated[int | None, typer.Option(min=1, help="Frames to acquire.")] = None,
    seed: opt.Seed = None,
    strict: opt.Strict = False,
    allow: opt.Allow = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    engine: opt.Engine = "local",
    address: opt.Address = None,
    as_json: opt.AsJson = False,
) -> None:
    """Acquire or import a dataset, and write it as shards, a training store and a card.

    Without --source, the configs that `data.also` of the settings names are added to it.
    """
    from racines_data.build import dataset
    from racines_data.config import section
    from racines_data.engines import LOCAL, open_engine
    from racines_data.sources.base import source_class

    start = time.perf_counter()
    values = section(read_settings(params, profile), "data")
    values |= given(source=source, workers=workers, frames=frames, seed=seed, strict=strict or None)
    values |= given(allow=allow or None)
    config, sections = dataset.read_data_section(values)
    known = {field.name for field in fields(source_class(config.source).Config)}
    if frames is not None and "frames" not in known:
        own = "has the frames of its inputs; leave it out"
        if "frames_per_sweep" in known:
            own = f"has so many a sweep: set data.{config.source}.frames_per_sweep"
        raise RacinesError(f"--frames: source {config.source} {own}")
    made = dataset.make_source(config, sections.get(config.source), inputs or [])
    many = dataset.make_multi_phantom(made, config, sections.get("multi_phantom"))
    others = [] if source else dataset.make_also(config, sections)
    told = not as_json
    with open_engine(engine, address, config.workers if engine == LOCAL else workers) as pool:
        manifest = dataset.build(made, out, config, told, many, pool)
        added = [dataset.build(other, out, config, told, engine=pool) for other in others]
    if as_json:
        summary = {key: manifest[key] for key in (*_KEYS, "tag")}
        summary["multi_phantom"] = manifest.get("multi_phantom")
        summary["also"] = [{key: each[key] for key in (*_KEYS, "tag")} for each in added]
        summary["findings"] = [vars(finding) for finding in made.report]
        summary["seconds"] = round(time.perf_counter() - start, 2)
        summary["peak_memory"] = dataset.peak_memory(config.workers)
        say_json({"out": str(out), **summary})
    else:
        _print_dataset(out, manifest)
        say(f"recipe  {manifest['recipe_digest']}")
        for each in added:
            _print_dataset(out, each)
        _print_findings(made.report)


def import_(
    inputs: Annotated[list[Path], typer.Argument(help="Folder or files to import.")],
    source: Annotated[
        str, typer.Option(help="release, cactus, tracked, table, rotation, or another's name.")
    ] = "release",
    out: opt.Out = Path("data/imported"),
    mapping: opt.Mapping = None,
    pixel_mm: opt.PixelMm = None,
    licence: Annotated[
        str, typer.Option(help="Licence of the recordings, e.g. CC-BY-4.0; kept on the card.")
    ] = "",
    consent: Annotated[
        str, typer.Option(help="Statement on consent of those scanned; kept on the card.")
    ] = "",
    origin: Annotated[
        str, typer.Option(help='Who made the recordings: "authors, URL"; kept on the card.')
    ] = "",
    settings: opt.Set = None,
    strict: opt.Strict = False,
    allow: opt.Allow = None,
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
    from racines_data.build import dataset
    from racines_data.config import section
    from racines_data.sources.licence import left_out

    values = section(read_settings(params, profile), "data") | given(
        source=source, workers=workers, seed=seed, max_refused=max_refused, strict=strict or None
    )
    values |= given(allow=allow or None, licence=licence or None, consent=consent or None)
    values |= given(origin=origin or None)
    config, sections = dataset.read_data_section(values)
    own = sections.get(config.source, {}) | overrides(settings)
    own |= given(mapping=mapping, pixel_mm=pixel_mm)
    made = dataset.make_source(config, own, inputs)
    if hasattr(made, "progress"):
        setattr(made, "progress", not as_json)  # noqa: B010
    try:
        manifest = dataset.build(made, out, config, progress=not as_json)
    except RacinesError as error:
        if as_json:
            say_json({"out": None, "error": str(error), **_report(made.report)})
        elif made.report:
            _print_kinds(made.report, "nothing was imported")
        raise
    if warning := left_out(made, config.licence, config.consent, config.origin):
        say(f"racines: {warning}", err=True)
    if as_json:
        summary = {key: manifest[key] for key in _KEYS}
        say_json({"out": str(out), **summary, **_report(made.report)})
        return
    _print_dataset(out, manifest)
    refused, flagged = manifest["report"]["refused_frames"], manifest["report"]["flagged"]
    if made.report:
        _print_kinds(made.report, f"{refused} frames refused, {flagged} findings flagged")
    else:
        say("every file is sound")


def _report(findings: list["Finding"]) -> dict[str, Any]:
    from racines_data.sources.folder import count_kinds

    return {"kinds": count_kinds(findings), "findings": [vars(finding) for finding in findings]}


def _print_dataset(out: Path, manifest: dict[str, Any]) -> None:
    counts = manifest["counts"]
    splits = ", ".join(f"{name} {count['frames']}" for name, count in counts["splits"].items())
    say(
        f"{out}: {manifest['source']} {manifest['version']}, {counts['frames']} frames in "
        f"{counts['trajectories']} trajectories ({splits})"
    )
    say(f"content {manifest['digest']}")


def _print_kinds(findings: list["Finding"], headline: str) -> None:
    say(headline)
    for kind, count in _report(findings)["kinds"].items():
        say(f"  {count:6d}  {kind}")
    _print_findings(findings)


def _print_findings(findings: list["Finding"]) -> None:
    for finding in findings[:_SHOWN]:
        verdict = "refused" if finding.refused else "flagged"
        item = f" {finding.item}" if finding.item else ""
        say(f"{verdict}: {finding.file}{item}: {finding.reason}")
    if len(findings) > _SHOWN:
        more = len(findings) - _SHOWN
        say(f"… and {more} more: see import_report.parquet, or --json")
