"""The command `racines audit`."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racines_data.cli import options as opt

if TYPE_CHECKING:
    from racines_leaderboard.audit.bench import Places
    from racines_leaderboard.audit.verdicts import Report


def audit(
    names: Annotated[
        list[str] | None, typer.Argument(help="Results, NAME or TRACK/NAME.", metavar="NAME...")
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="All results.")] = False,
    board: opt.Board = None,
    quick: Annotated[bool, typer.Option("--quick", help="Make no number again.")] = False,
    retrain: Annotated[
        bool,
        typer.Option("--retrain", help="Train anew; where all holds, the tier is reproduced."),
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
    from racines_leaderboard.audit.bench import Places
    from racines_leaderboard.audit.pages import show

    judges = {"grader": grader, "pose": pose}
    given = {kind: folder for kind, folder in judges.items() if folder is not None}
    places = Places(results, submissions, data, params or Path("params.yaml"), judges=given)
    if bool(names) == every:
        raise typer.BadParameter("give names, or --all")
    if quick and retrain:
        raise typer.BadParameter("--quick makes no number again, --retrain does: give one")
    reports = []
    for report in _reports(names or [], board, places, quick, retrain_into if retrain else None):
        reports.append(report)
        if not as_json:
            show(report, details)
        if seal and report.holds:
            _seal(places.results / report.board / report.track / f"{report.name}.json")
    document = _document(reports)
    if out is not None:
        _write(out, document, reports)
    if as_json:
        typer.echo(json.dumps(document, indent=2, ensure_ascii=False))
    if not document["holds"]:
        raise typer.Exit(1)


def _reports(
    names: list[str], board: str | None, places: "Places", quick: bool, into: Path | None
) -> Any:
    """Give the report of each record as it is made."""
    from racines_leaderboard.audit.bench import Bench
    from racines_leaderboard.audit.retrain import retrain
    from racines_leaderboard.audit.run import audit as audit_record
    from racines_leaderboard.audit.run import find_records

    benches: dict[str, Bench] = {}
    for path in find_records(places.results, names, board):
        bench = benches.setdefault(path.parts[-3], Bench(path.parts[-3], places))
        if into is None:
            yield audit_record(path, bench, quick)
        else:
            yield retrain(path, bench, into)


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
    document = json.loads(json.dumps(document))
    check(document, "audit", "the report")
    return document


def _write(out: Path, document: dict[str, Any], reports: list["Report"]) -> None:
    from racines_data.files import write_atomic, write_json
    from racines_leaderboard.audit.pages import audit_markdown

    if out.suffix == ".json":
        write_json(out, document)
    else:
        write_atomic(out, audit_markdown(reports))


def _seal(path: Path) -> None:
    """Seal a record that has no seal."""
    from racines_data.files import write_atomic
    from racines_leaderboard.records.seal import KEY, sealed

    record = json.loads(path.read_text())
    if KEY not in record:
        write_atomic(path, json.dumps(sealed(record), indent=2, ensure_ascii=False) + "\n")
        typer.echo(f"racines: sealed: {path}", err=True)
