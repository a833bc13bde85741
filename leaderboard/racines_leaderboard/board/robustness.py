"""Robustness reports that were handed in: looked into, and made a row of what a board shows."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_envs.evaluation.patients import PatientsConfig, start_set
from racines_envs.studies.robustness.disturbances import DISTURBANCES
from racines_envs.studies.robustness.disturbances import told as amounts
from racines_envs.studies.robustness.run import (
    NOTHING,
    RANKED,
    RobustnessConfig,
    conditions,
    described,
)
from racines_envs.studies.robustness.summary import found_disturbed, single
from racines_envs.task.names import BEATING, PATIENTS, tier_of
from racines_leaderboard.records.robustness import METRIC, apart, hashes_of, reports_of
from racines_leaderboard.records.schema import check, read_json

SCHEMA = "racines.robustness-record/1"
SPLIT, FEWEST = "validation", 20
"""On whom a report is made: test patients are for what ranks, and looked at once."""
CLOSE = 1e-9
Record = dict[str, Any]


def robustness_of(record: Record, submissions: Path) -> Record | None:
    """Return what the report of a record's task says, among the artefacts of its submission.

    Args:
        record: As it is about to be written; its submission names the artefacts.
        submissions: The folder of its track's submissions, where they lie.

    Raises:
        RacinesError: a report that is damaged, of other weights, patients or disturbances than a
            board shows, whose figures do not follow from its episodes, or two of one task.
    """
    found: list[Record] = []
    for artefact in reports_of(record):
        path = submissions / record["submission"]["name"] / artefact["path"]
        if not path.is_file():
            continue  # at its URL: nothing is shown of it
        report = read_report(path)
        if report["task"]["view"] == record["scores"]["task"]["view"]:
            found.append(_row(record, report, path))
        if len(found) > 1:
            view = record["scores"]["task"]["view"]
            raise RacinesError(f"{path}: a second robustness report of {view}: hand in one")
    return found[0] if found else None


def read_report(path: Path) -> dict[str, Any]:
    """Read a report, and hold it against what it has to be of for a board.

    Raises:
        RacinesError: the first fault, with its file, field and remedy.
    """
    report = read_json(path, "robustness")
    for field, fault in _faults(report):
        raise RacinesError(f"{path}: {field}: {fault}; racines eval robustness makes one")
    return report


def _faults(report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Give what is wrong with a report: the field, and why; the first matters."""
    starts, units = report["task"]["start_set"], report["patients"]
    view = report["task"]["view"]
    tier = tier_of(view)
    if tier not in (PATIENTS, BEATING):
        yield "task.view", f"{view!r} is no task on patients"
        return
    if starts["split"] != SPLIT or starts["patients"] < FEWEST:
        yield "task.start_set", f"a board shows {FEWEST} or more {SPLIT} patients"
        return
    names = ("split", "patients", "starts")
    config = PatientsConfig(
        view=view, seed=starts["seeds"][0], **{name: starts[name] for name in names}
    )
    if len(units) != starts["patients"] * starts["starts"]:
        yield "patients", f"{len(units)}, and the start set has {starts['patients']} patients"
        return
    here = start_set(config)
    if here.told(config) != starts or here.units.tolist() != units:
        yield "patients", "others, or other starts, than the start set's here"
    wanted = [name for name, each in DISTURBANCES.items() if tier in each.tiers]
    told = {name: report["disturbances"].get(name, {}).get("amounts") for name in wanted}
    if told != {name: described(name)["amounts"] for name in wanted}:
        yield "disturbances", "other amounts than those here"
    rows = report["conditions"]
    asked = {
        each.title: {"name": each.name, "strength": each.strength, "amounts": amounts(each.applied)}
        for each in conditions(RobustnessConfig(view=view, disturbances=tuple(wanted)))
    }
    for title in dict.fromkeys((*asked, *rows)):
        if title not in rows:
            yield "conditions", f"without {title}"
            return
        if title not in asked or any(rows[title][key] != asked[title][key] for key in asked[title]):
            yield f"conditions.{title}", "none of those here, or of other amounts"
            return
    yield from _unlike(rows, len(rows[NOTHING]["found"]), len(units))


def _unlike(conditions: dict[str, Any], trainings: int, count: int) -> Iterator[tuple[str, str]]:
    """Give the conditions whose share is not that of their episodes."""
    for title, row in conditions.items():
        found = row["found"]
        if len(found) != trainings or any(len(each) != count for each in found):
            yield f"conditions.{title}.found", f"not of {trainings} trainings and {count} starts"
            return
        share = sum(map(sum, found)) / (trainings * count)
        stated = row["metrics"][RANKED]["value"]
        if stated is None or abs(stated - share) > CLOSE:
            yield f"conditions.{title}.metrics.{RANKED}", f"{stated}, and its episodes say {share}"


def _row(record: Record, report: dict[str, Any], path: Path) -> Record:
    """Return what a board keeps of a report; refuse one that is of another agent or world."""
    own = record["scores"]["submission"]
    if report["submission"] != own:
        raise RacinesError(
            f"{path}: submission: {report['submission']!r}, and the row is of {own!r}"
        )
    row = {
        "schema": SCHEMA,
        "board": record["board"],
        "agent": record["name"],
        "report": sha256_file(path),
        "weights": hashes_of(report),
        "code": report["code"],
        "task": report["task"],
        "phantom": report["phantom"],
        "disturbances": sorted(single(report)),
        "metrics": {METRIC: found_disturbed(report)},
    }
    if (other := apart(row, record["scores"])) is not None:
        raise RacinesError(f"{path}: {other} than the row {record['name']}: make it again")
    check(row, "robustness-record", str(path))
    return row
