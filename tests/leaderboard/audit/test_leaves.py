"""Each leaf of a record is changed in turn and sealed again: it is noticed, or nothing rests on it.

The numbers are made again once; every audit is held against those. `make test` changes some of
the leaves, drawn by a seed; `make test-thorough` all of them.
"""

import copy
import json
import random
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from racines_leaderboard.audit.bench import Bench, Places
from racines_leaderboard.audit.leaves import informative, leaves
from racines_leaderboard.audit.numbers import TOLERANCE, bounds_of
from racines_leaderboard.audit.roads import Made, Road, find_road
from racines_leaderboard.audit.run import audit
from racines_leaderboard.audit.verdicts import Report
from racines_leaderboard.records.schema import sealed
from tests.leaderboard.audit.conftest import SUBMISSIONS

NUMBERS = ("value", "low", "high")
UNMADE = re.compile(r"scores\.weights\.(files\.)?seed-\d+/.+")
"""Digests of trainings that are not here: told by training again, and said to be `retrainable`."""
Change = Callable[[dict[str, Any]], None]


@dataclass
class Held:
    """A record, and audits of what is made of it against numbers made again once."""

    path: Path
    made: Made | None = None

    def __post_init__(self) -> None:
        self.record = json.loads(self.path.read_text())
        self.bench = Bench(self.record["board"], Places())

    def find(self, record: dict[str, Any], bench: Bench) -> Road | str:
        road = find_road(record, bench)
        if isinstance(road, str):
            return road
        if self.made is None:
            self.made = Made.of(road.score())
        kept = self.made
        return replace(road, score=lambda: kept)

    def audit(self, record: dict[str, Any]) -> Report:
        self.path.write_text(json.dumps(sealed(record)))
        return self.audit_as_it_lies()

    def audit_as_it_lies(self) -> Report:
        return audit(self.path, self.bench, find=self.find)

    def changed(self, change: Change) -> Report:
        record = copy.deepcopy(self.record)
        change(record)
        return self.audit(record)


def parent(record: Any, place: str) -> tuple[Any, Any]:
    """Return the container of a leaf, and its key there."""
    words = place.split(".")
    while True:
        # Names of files have dots of their own.
        count = 1
        while isinstance(record, dict) and ".".join(words[:count]) not in record:
            count += 1
        key, words = ".".join(words[:count]), words[count:]
        step = int(key) if isinstance(record, list) else key
        if not words:
            return record, step
        record = record[step]


def other(value: Any) -> Any:
    """Return another value of the same kind, near by."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1
    if isinstance(value, float):
        return value + 1e-6
    if isinstance(value, str):
        return value[:-1] + ("0" if value[-1:] != "0" else "1")
    return {"a": 1} if isinstance(value, dict) else [1] if isinstance(value, list) else 0.5


def put(place: str, value: Any) -> Change:
    def change(record: dict[str, Any]) -> None:
        container, key = parent(record, place)
        container[key] = value

    return change


def drop(place: str) -> Change:
    def change(record: dict[str, Any]) -> None:
        container, key = parent(record, place)
        del container[key]

    return change


def elsewhere(held: Held, place: str) -> Change:
    """Move a number by a little more than passes, in a record that names another machine."""
    metric = place.split(".")[-2]
    assert held.made is not None
    here = held.made.scores["metrics"][metric]
    bound, _ = bounds_of(metric, here, TOLERANCE, held.record["track"])

    def change(record: dict[str, Any]) -> None:
        record["scores"]["environment"]["cpu"] = "another"
        container, key = parent(record, place)
        container[key] += 1.01 * bound + 1e-9

    return change


def changes(held: Held, place: str, value: Any) -> Iterator[tuple[str, Change]]:
    """Give what is done to a leaf, in words and as a function."""
    words = place.split(".")
    yield "a little", put(place, other(value))
    if not (words[-1] in NUMBERS and "metrics" in words):
        yield "dropped", drop(place)
    if isinstance(value, int | float) and not isinstance(value, bool):
        yield "a lot", put(place, value * 1000 + 1000)
        if words[1] == "metrics" and words[-1] in NUMBERS and not informative(place):
            yield "elsewhere", elsewhere(held, place)


def in_both(place: str, value: Any) -> Change:
    """Change a leaf of the submission in the record and in the file that lies here."""

    def change(record: dict[str, Any]) -> None:
        put(place, other(value))(record)
        folder = SUBMISSIONS / record["track"] / record["submission"]["name"]
        if folder.is_dir():
            (folder / "submission.yaml").write_text(yaml.safe_dump(record["submission"]))

    return change


def one_of(share: int, document: dict[str, Any]) -> list[tuple[str, Any]]:
    """Return the leaves of a document, or one of so many, drawn by a seed."""
    found = [(place, value) for place, value in leaves(document) if place != "seal"]
    return sorted(random.Random(0).sample(found, -(-len(found) // share)), key=found.index)


def go_through(held: Held, share: int) -> Counter[str]:
    """Change leaves; return how many there are, were caught, and are declared informative."""
    assert held.audit(held.record).holds
    counts: Counter[str] = Counter()
    missed = []
    for place, value in one_of(share, held.record):
        counts["leaves"] += 1
        retrainable = UNMADE.fullmatch(place) is not None
        declared = informative(place) or retrainable
        for how, change in changes(held, place, value):
            report = held.changed(change)
            counts["changes"] += 1
            left_open = report.holds or (retrainable and how == "dropped")
            if not (report.fails or (declared and left_open)):
                missed.append((place, how, value, report.verdict))
        kind = "retrainable" if retrainable else "informative" if declared else "caught"
        counts[kind] += 1
    missed += list(with_its_file(held, counts, share))
    assert not missed, missed
    return counts


def with_its_file(
    held: Held, counts: Counter[str], share: int
) -> Iterator[tuple[str, str, Any, str]]:
    """Change each leaf of the submission in its file as well; give what passes undeclared."""
    document = held.record["submission"]
    if document is None:
        return
    path = SUBMISSIONS / document["track"] / document["name"] / "submission.yaml"
    before = path.read_text()
    for leaf, value in one_of(share, document):
        place = f"submission.{leaf}"
        report = held.changed(in_both(place, value))
        path.write_text(before)
        counts["changes"] += 1
        if not report.fails and not informative(place):
            yield place, "in both", value, report.verdict


@pytest.mark.parametrize("every", [False, pytest.param(True, marks=pytest.mark.thorough, id="all")])
@pytest.mark.parametrize(
    ("name", "least", "one_in"),
    [
        ("judged", 250, 6),
        ("handed_in", 150, 6),
        pytest.param("guided", 180, 6, marks=pytest.mark.thorough),
        pytest.param("scanned", 600, 30, marks=pytest.mark.thorough),
        ("learned", 500, 30),
        pytest.param("painted", 250, 12, marks=pytest.mark.thorough),
    ],
)
def test_every_leaf_is_caught_or_declared(name, least, one_in, every, request):
    share = 1 if every else one_in
    held = Held(request.getfixturevalue(name))
    counts = go_through(held, share)
    print(name, dict(counts))
    told = counts["caught"] + counts["informative"] + counts["retrainable"]
    assert counts["leaves"] == told and counts["retrainable"] <= 2
    assert counts["leaves"] >= least / share and counts["informative"] <= 45
