"""The commands `racines audit` and `racines study determinism`: what holds, and what repeats."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.terminal import say, say_json, say_page

if TYPE_CHECKING:
    from racines_leaderboard.audit.verdicts import Report


def audit(
    names: Annotated[
        list[str] | None, typer.Argument(help="Results, NAME or TRACK/NAME.", metavar="NAME...")
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="All results.")] = False,
    board: opt.Board = None,
    quick: Annotated[bool, typer.Option("--quick", help="Make no number again.")] = False,
    retrain: Annotated[
        bool, typer.Option("--retrain", help="Train anew; where all holds, the tier is reproduced.")
    ] = False,
    retrain_into: Annotated[
        Path, typer.Option(help="With --retrain: folder of the runs; a killed one goes on.")
    ] = Path("models/runs/retrained"),
    data: opt.Data = opt.DATA,
    grader: opt.Grader = None,
    pose: opt.Pose = None,
    params: opt.Params = None,
    results: opt.Results = opt.RESULTS,
    submissions: opt.Submissions = opt.SUBMISSIONS,
    unconfined: opt.Unconfined = False,
    details: opt.Details = False,
    seal: Annotated[
        bool, typer.Option("--seal", help="Seal records that have no seal and do not fail.")
    ] = False,
    out: opt.OwnOutFile = None,
    as_json: opt.AsJson = False,
) -> None:
    """Check results number by number: holds, does not hold, cannot be checked and why.

    Judges are those of models/runs, or else of models/weights. The report goes to --out: .json, or
    Markdown. Exits 1 if anything does not hold.
    """
    from racines_data.files import write_atomic, write_json
    from racines_leaderboard.audit import run
    from racines_leaderboard.audit.bench import Bench, Places
    from racines_leaderboard.audit.verdicts import audit_markdown, show
    from racines_leaderboard.submissions.confined.session import Limits

    judges = {"grader": grader, "pose": pose}
    given = {kind: folder for kind, folder in judges.items() if folder is not None}
    settings, limits = params or Path("params.yaml"), Limits(unconfined=unconfined)
    places = Places(results, submissions, data, settings, judges=given, limits=limits)
    if bool(names) == every:
        raise typer.BadParameter("give names, or --all")
    if quick and retrain:
        raise typer.BadParameter("--quick makes no number again, --retrain does: give one")
    benches: dict[str, Bench] = {}
    reports = []
    for path in run.find_records(places.results, names or [], board):
        bench = benches.setdefault(path.parts[-3], Bench(path.parts[-3], places))
        if retrain:
            report = run.retrain(path, bench, retrain_into)
        else:
            report = run.audit(path, bench, quick)
        reports.append(report)
        if not as_json:
            show(report, details)
        if seal and report.holds:
            _seal(path)
    document = _document(reports)
    if out is not None and out.suffix == ".json":
        write_json(out, document)
    elif out is not None:
        write_atomic(out, audit_markdown(reports))
    if as_json:
        say_json(document, indent=2)
    if not document["holds"]:
        raise typer.Exit(1)


def _document(reports: list["Report"]) -> dict[str, Any]:
    from racines_leaderboard.records.schema import check
    from racines_models.provenance import code_version, environment

    document = {
        "schema": "racines.audit/1",
        "holds": all(report.holds for report in reports),
        "environment": environment(),
        "code": code_version(),
        "reports": [report.to_json() for report in reports],
    }
    check(document := json.loads(json.dumps(document)), "audit", "the report")
    return document


def _seal(path: Path) -> None:
    """Seal a record that has no seal."""
    from racines_leaderboard.records.schema import KEY, sealed, write_record

    record = json.loads(path.read_text())
    if KEY not in record:
        write_record(path, sealed(record))
        say(f"racines: sealed: {path}", err=True)


def determinism(
    stage: Annotated[
        list[str] | None, typer.Option(help="Only stages that begin so; repeatable.")
    ] = None,
    out: opt.OwnOutFile = None,
    as_json: opt.AsJson = False,
) -> None:
    """Measure how far each stage repeats itself: bitwise, or by the largest difference.

    Twice, in another process, with 2 threads, row by row, and with other instruction sets. Exit 1
    if a stage gives other bytes the second time or in another process. With --out the report is
    written as JSON, stage by stage; a killed run goes on.
    """
    from racines_data.errors import RacinesError
    from racines_leaderboard.determinism.run import (
        Outcome,
        determinism_markdown,
        measure,
        unrepeated,
    )

    def tell(outcome: Outcome) -> None:
        said = outcome.note or ("bitwise" if outcome.bitwise else f"{outcome.largest:.2g}")
        line = f"{outcome.stage}, {outcome.compared}: {said} ({outcome.seconds} s)"
        say(f"racines: {line}", err=True)

    document = measure(stage or (), tell, out)
    if as_json:
        say_json(document, indent=2)
    else:
        say_page(determinism_markdown(document))
    if broken := unrepeated(document):
        raise RacinesError(f"not the same bytes a second time: {', '.join(broken)}")
