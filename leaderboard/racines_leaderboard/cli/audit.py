"""The command `racines audit`."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from racines_leaderboard.audit.bench import Places
    from racines_leaderboard.audit.verdicts import Report

RESULTS = Path("leaderboard/results")
SUBMISSIONS = Path("leaderboard/submissions")


def register(app: typer.Typer) -> None:
    """Add the command to the root."""
    app.command("audit")(audit)


def audit(
    names: Annotated[
        list[str] | None, typer.Argument(help="Results, NAME or TRACK/NAME.", metavar="NAME...")
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="All results.")] = False,
    board: Annotated[str | None, typer.Option(help="Only of this board.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Make no number again.")] = False,
    retrain: Annotated[
        bool,
        typer.Option("--retrain", help="Train anew; where all holds, the tier is reproduced."),
    ] = False,
    retrain_into: Annotated[
        Path, typer.Option(help="With --retrain: folder of the runs; a killed one goes on.")
    ] = Path("models/runs/retrained"),
    data: Annotated[Path, typer.Option(help="The dataset.")] = Path("data/racines"),
    grader: Annotated[
        Path | None, typer.Option(help="Folder of the grader; models/runs or models/weights.")
    ] = None,
    pose: Annotated[
        Path | None, typer.Option(help="Folder of the pose regressor; likewise.")
    ] = None,
    params: Annotated[Path, typer.Option(help="Settings of its board.")] = Path("params.yaml"),
    results: Annotated[Path, typer.Option(help="Folder of the boards.")] = RESULTS,
    submissions: Annotated[Path, typer.Option(help="Folder of the submissions.")] = SUBMISSIONS,
    details: Annotated[bool, typer.Option("--details", help="Show what holds as well.")] = False,
    seal: Annotated[
        bool, typer.Option("--seal", help="Seal records that have no seal and do not fail.")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Write the report: .json, or Markdown.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """Check results number by number: holds, does not hold, cannot be checked and why.

    Exits 1 if anything does not hold.
    """
    from racines_leaderboard.audit.bench import Places
    from racines_leaderboard.audit.pages import show

    judges = {"grader": grader, "pose": pose}
    given = {kind: folder for kind, folder in judges.items() if folder is not None}
    places = Places(results, submissions, data, params, judges=given)
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
