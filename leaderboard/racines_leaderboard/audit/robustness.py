"""Claims on what a board shows of a robustness report: that it follows from what was handed in."""

from collections.abc import Iterator
from pathlib import Path

from racines_data.errors import RacinesError
from racines_leaderboard.audit.bench import Bench
from racines_leaderboard.audit.verdicts import Verdict, equal, fails, told
from racines_leaderboard.board.collect import Record
from racines_leaderboard.board.robustness import robustness_of
from racines_leaderboard.records.robustness import FOLDER, METRIC, reports_of
from racines_leaderboard.records.schema import read_json
from racines_leaderboard.records.tracks import PATIENT_AGENTS


def check_robustness(record: Record, path: Path, bench: Bench) -> Iterator[Verdict]:
    """Make what a board keeps of a record's report again, from the report.

    Args:
        record: The record.
        path: Its file.
        bench: Names the folder of the submissions.
    """
    if record["track"] != PATIENT_AGENTS.name:
        return
    kept = path.parents[1] / FOLDER / path.name
    if not (reports_of(record) or kept.is_file()):
        return
    try:
        shown = read_json(kept, "robustness-record") if kept.is_file() else None
        made = robustness_of(record, bench.places.submissions / record["track"])
    except RacinesError as error:
        yield fails("robustness", str(error))
        return
    yield equal("robustness", shown, made, "made again from the report that was handed in")
    if made is not None:
        own = "the submitter's own run, which ranks nothing; racines eval robustness makes it again"
        yield told("robustness.report", own, made["metrics"][METRIC]["value"])
