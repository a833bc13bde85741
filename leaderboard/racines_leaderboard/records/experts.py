"""Experts' agreement on a board: one record a generator, shown beside the scores it belongs to.

Only what experts rated is taken: answers of programs and of trials are refused, and a record that
claims otherwise does not pass its schema.
"""

from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.files import locked
from racines_leaderboard.records.schema import check, read_json, write_record

EXPERT = "expert"
"""A person who says to be one; the only kind of rater that gets to a board."""
MACHINES = ("simulated", "oracle", "grader")
"""Programs that rate."""
KINDS = (EXPERT, "trial", *MACHINES)
"""Who rates: an expert, somebody who tries the kit out, or a program."""
TRUE_FRAMES = "true-frames"
"""The system that shows the dataset's own frames."""
OVERALL = "overall"
"""All generators' images together, in a report."""
FOLDER = "expert"
METRICS = {"expert_view": "view_agreement", "expert_grade": "grade_agreement"}
"""Columns of a board, and the metrics of a study that they show."""


def publish(report: dict[str, Any], results: Path, board: str) -> list[Path]:
    """Write an expert study's agreement with the truth into a board; return the files.

    One process at a time writes to boards: what is checked is what is there at the writing.

    Raises:
        RacinesError: the raters are no experts, or a generator has no scores on the board, or
            scores of another dataset or other weights.
    """
    if report["kind"] != EXPERT:
        raise RacinesError(f"{report['remark']} A board takes ratings of experts alone")
    with locked(results):
        records = _records(report, results, board)
        for path, record in records.items():
            write_record(path, record)
    return list(records)


def _records(report: dict[str, Any], results: Path, board: str) -> dict[Path, dict[str, Any]]:
    """Return the records of a study's generators by file; `publish` says what is refused."""
    records = {}
    for name in report["systems"]:
        if name in (OVERALL, TRUE_FRAMES):
            continue
        record, path = _record(report, board, name), results / board / FOLDER / f"{name}.json"
        check(record, "expert-record", str(path))
        scores = results / board / "generators" / f"{name}.json"
        if not scores.is_file():
            raise RacinesError(f"{scores}: no scores of {name} on the board; collect them first")
        if (fault := _fault(record, read_json(scores, "record")["scores"])) is not None:
            raise RacinesError(f"board {board}: {name}: {fault}")
        records[path] = record
    if not records:
        raise RacinesError("the study has no generator's images, so a board has no row for it")
    return records


def with_experts(records: list[dict[str, Any]], folder: Path) -> list[dict[str, Any]]:
    """Add to each generator's record the metrics that experts gave it, as `expert`.

    A study of other data or weights than the record's is left out, and `expert_stale` says so.

    Raises:
        RacinesError: a damaged record, or one in another's place.
    """
    return [_extended(record, folder / f"{record['name']}.json") for record in records]


def _extended(record: dict[str, Any], path: Path) -> dict[str, Any]:
    if not path.is_file():
        return record
    study = read_json(path, "expert-record")
    for key, value in (("generator", record["name"]), ("board", record["board"])):
        if study[key] != value:
            raise RacinesError(f"{path}: {key}: {study[key]!r}, expected {value!r}")
    stale = _fault(study, record["scores"]) is not None
    return record | ({"expert_stale": True} if stale else {"expert": study["metrics"]})


def _record(report: dict[str, Any], board: str, name: str) -> dict[str, Any]:
    system = report["systems"][name]
    agreement = system["references"].get(report["truth"])
    if agreement is None:
        raise RacinesError(f"{name}: the dataset has no views to agree with; none to publish")
    return {
        "schema": "racines.expert-record/1",
        "board": board,
        "generator": name,
        "kind": report["kind"],
        "kit": report["kit"]["digest"],
        "raters": [{key: each[key] for key in ("rater", "about")} for each in report["raters"]],
        "dataset": report["dataset"],
        "weights": system["weights"],
        "truth": report["truth"],
        "metrics": {column: agreement["metrics"][key] for column, key in METRICS.items()},
    }


def _fault(study: dict[str, Any], scores: dict[str, Any]) -> str | None:
    """Say why a study does not belong to some scores, or None."""
    data, other = study["dataset"]["recipe_digest"], scores["dataset"]["recipe_digest"]
    if data != other:
        return f"the study is of recipe {str(data)[:12]}, the scores are of {str(other)[:12]}"
    if not (study["weights"] or {}).items() <= (scores["weights"] or {}).items():
        return "the study is of other weights than the scores; score the generator that was shown"
    return None
