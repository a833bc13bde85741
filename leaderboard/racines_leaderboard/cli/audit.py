"""The commands `racines audit` and `racines study determinism`: what holds, and what repeats."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.terminal import note, say_json, say_page

if TYPE_CHECKING:
    from racines_leaderboard.audit.verdicts import Report


def audit(
    names: Annotated[
        list[str] | None, typer.Argument(help="Results, NAME or TRACK/NAME.", metavar="NAME...")
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="All results.")] = False,
    board: opt.Board = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Make no number again: holds is never said.")
    ] = False,
    retrain: Annotated[
        bool, typer.Option("--retrain", help="Train anew; where all holds, the tier is reproduced.")
    ] = False,
    retrain_into: Annotated[
        Path, typer.Option(help="With --retrain: folder of the runs; a killed one goes on.")
    ] = Path("models/runs/retrained"),
    data: Annotated[
        list[Path] | None,
        typer.Option(
            help="Folder of the dataset.",
        ),
    ] = None,
    grader: opt.Grader = None,
    pose: opt.Pose = None,
    params: opt.Params = None,
    results: opt.Results = opt.RESULTS,
    submissions: opt.Submissions = opt.SUBMISSIONS,
    unconfined: opt.Unconfined = False,
    engine: opt.Engine = "local",
    address: opt.Address = None,
    details: opt.Details = False,
    seal: Annotated[
        bool, typer.Option("--seal", help="Seal records that have no seal and do not fail.")
    ] = False,
    keep: Annotated[
        bool, typer.Option("--keep", help="Keep the verdicts in RESULTS/BOARD/audit.json.")
    ] = False,
    out: opt.OwnOutFile = None,
    as_json: opt.AsJson = False,
) -> None:
    """Check results number by number: each holds, does not hold, or is not verified, and why.

    --data may be repeated: each board takes the dataset of its recipe, also of those in data/.
    Judges are those of models/runs, or else of models/weights. The report goes to --out: .json, or
    Markdown. Exits 0 if all that ranks was recomputed and holds, 1 if anything does not hold, else
    3: not verified, with the commands that would verify it.
    """
    from racines_data.engines import LOCAL
    from racines_data.files import write_atomic, write_json
    from racines_leaderboard.audit import run
    from racines_leaderboard.audit.bench import Places
    from racines_leaderboard.audit.verdicts import audit_markdown, show
    from racines_leaderboard.records.verdicts import EXITS
    from racines_leaderboard.submissions.confined.session import Limits
    from racines_models.cli.device import spread

    judges = {"grader": grader, "pose": pose}
    given = {kind: folder for kind, folder in judges.items() if folder is not None}
    settings, limits = params or Path("params.yaml"), Limits(unconfined=unconfined)
    first, *further = data or [opt.DATA]
    places = Places(
        results, submissions, first, settings, judges=given, limits=limits, further=tuple(further)
    )
    if bool(names) == every:
        raise typer.BadParameter("give names, or --all")
    if quick and retrain:
        raise typer.BadParameter("--quick makes no number again, --retrain does: give one")
    if retrain and engine != LOCAL:
        raise typer.BadParameter("--retrain trains on this machine: leave --engine out")
    reports, paths = [], run.find_records(places.results, names or [], board)
    with spread(engine, address) as pool:
        if retrain:
            opened = run.Auditor(places)
            found = (run.retrain(path, opened.bench(path), retrain_into) for path in paths)
        else:
            found = run.audit_all(paths, places, quick, pool)
        for path, report in zip(paths, found, strict=True):
            reports.append(report)
            if not as_json:
                show(report, details)
            if seal and not report.fails:
                _seal(path)
    if keep:
        _keep(places.results, reports)
    document = _document(reports)
    if out is not None and out.suffix == ".json":
        write_json(out, document)
    elif out is not None:
        write_atomic(out, audit_markdown(reports))
    if as_json:
        say_json(document, indent=2)
    if code := EXITS[document["verdict"]]:
        raise typer.Exit(code)


def _document(reports: list["Report"]) -> dict[str, Any]:
    from racines_leaderboard.records.schema import check
    from racines_leaderboard.records.verdicts import DOES_NOT_HOLD, HOLDS, NOT_VERIFIED
    from racines_models.provenance import code_version, environment

    said = {report.verdict for report in reports}
    verdict = next(each for each in (DOES_NOT_HOLD, NOT_VERIFIED, HOLDS) if each in said)
    document = {
        "schema": "racines.audit/1",
        "verdict": verdict,
        "holds": verdict == HOLDS,
        "environment": environment(),
        "code": code_version(),
        "reports": [report.to_json() for report in reports],
    }
    check(document := json.loads(json.dumps(document)), "audit", "the report")
    return document


def _keep(results: Path, reports: list["Report"]) -> None:
    """Keep the verdicts of each board beside its records."""
    from racines_leaderboard.audit.verdicts import kept_of
    from racines_leaderboard.records.verdicts import keep_verdicts

    for board in sorted({report.board for report in reports}):
        those = [report for report in reports if report.board == board]
        path = keep_verdicts(results / board, kept_of(those, results))
        note(f"racines: verdicts kept: {path}")


def _seal(path: Path) -> None:
    """Seal a record that has no seal."""
    from racines_data.files import locked
    from racines_leaderboard.records.schema import KEY, sealed, write_record

    with locked(path.parents[2]):
        record = json.loads(path.read_text(encoding="utf-8"))
        if KEY not in record:
            write_record(path, sealed(record))
            note(f"racines: sealed: {path}")


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
        note(f"racines: {line}")

    document = measure(stage or (), tell, out)
    if as_json:
        say_json(document, indent=2)
    else:
        say_page(determinism_markdown(document))
    if broken := unrepeated(document):
        raise RacinesError(f"not the same bytes a second time: {', '.join(broken)}")
