"""`make mutants`: run the tests on every mutant and report those that live.

Results are kept as they come, so a run that was stopped goes on. A kill holds as long as the
module's text does; a mutant that lived is tried again when its tests have changed.
"""

import argparse
import hashlib
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from tests.mutants.catalogue import ROOT, Group, Mutant, at_random, by_hand, groups
from tests.mutants.process import Outcome, Run, preload

SLACK, LEAST = 10.0, 120.0
"""A mutant may take so many times what its tests take without it, and at least so many seconds."""
SHARE = 0.04
"""Of the mutants by hand that may live."""
DRAWN = 25
"""Random mutants a group."""
SEED = 15
Tests = tuple[str, ...]


class Results:
    """Outcomes on disk, by the key of the mutant, and seconds of the tests without any."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.rows: dict[str, dict[str, Any]] = (
            json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        )

    def of(self, mutant: Mutant) -> dict[str, Any] | None:
        """Return the outcome, if it still holds."""
        row = self.rows.get(mutant.key, {"verdict": "error"})
        lived = row["verdict"] == "survived"
        stale = lived and row["tests"] != digest(mutant.tests)
        return None if stale or row["verdict"] == "error" else row

    def seconds(self, tests: Tests) -> float | None:
        """Return how long tests took without a mutant, if that is known."""
        return self.rows.get(plain(tests), {}).get("seconds")

    def put(self, key: str, **row: Any) -> None:
        """Keep an outcome."""
        self.rows[key] = row
        part = self._path.with_suffix(".part")
        part.write_text(json.dumps(self.rows, indent=1) + "\n")
        part.replace(self._path)


def digest(tests: Iterable[str]) -> str:
    """Return a hash of the files of tests."""
    texts = [(ROOT / test.split("::")[0]).read_bytes() for test in tests]
    return hashlib.sha256(b"\0".join(texts)).hexdigest()[:16]


def plain(tests: Tests) -> str:
    """Return the key of tests without a mutant."""
    return f"unmutated {digest(tests)} {' '.join(tests)}"


def mutants(chosen: list[Group], kind: str) -> Iterator[Mutant]:
    """Yield the mutants of groups: by hand first, since they are named."""
    if kind != "random":
        for group in chosen:
            yield from by_hand(group)
    if kind != "hand":
        for group in chosen:
            yield from at_random(group, DRAWN, SEED)


def run(todo: list[Mutant], results: Results, jobs: int) -> None:
    """Test mutants, some at once, and keep what comes out.

    The tests of a module are run once without a mutant, to know that they pass and how long they
    take; its mutants wait for that, others do not.
    """
    waiting: list[Mutant | Tests] = []
    for mutant in todo:
        if mutant.tests not in waiting and results.seconds(mutant.tests) is None:
            waiting.append(mutant.tests)
        waiting.append(mutant)
    under_way: dict[Run, Mutant | Tests] = {}
    while waiting or under_way:
        while len(under_way) < jobs and (each := _next(waiting, results)):
            waiting.remove(each)
            under_way[_start(each, results)] = each
        time.sleep(0.05)
        for started in list(under_way):
            if outcome := started.poll():
                _keep(under_way.pop(started), outcome, results)
                print(f"  {len(waiting) + len(under_way)} to go", flush=True)


def _next(waiting: list[Mutant | Tests], results: Results) -> Mutant | Tests | None:
    ready = (e for e in waiting if isinstance(e, tuple) or results.seconds(e.tests) is not None)
    return next(ready, None)


def _start(each: Mutant | Tests, results: Results) -> Run:
    if isinstance(each, tuple):
        return Run(each, 3600.0)
    limit = max(LEAST, SLACK * (results.seconds(each.tests) or 0.0))
    return Run(each.tests, limit, each.file, each.source)


def _keep(each: Mutant | Tests, outcome: Outcome, results: Results) -> None:
    seconds = round(outcome.seconds, 1)
    if isinstance(each, tuple):
        if outcome.verdict != "survived":
            sys.exit(f"{' '.join(each)}: {outcome.verdict} without any mutant: {outcome.by}")
        results.put(plain(each), seconds=seconds)
        print(f"unmutated {seconds:6.1f} s  {' '.join(each)}", end="")
        return
    row = {"name": each.name, "kind": each.kind, "group": each.group}
    row |= {"verdict": outcome.verdict, "seconds": seconds, "by": outcome.by}
    results.put(each.key, **row, tests=digest(each.tests))
    print(f"{outcome.verdict:9} {seconds:6.1f} s  {each.name}  {outcome.by}", end="")


def report(all_of: list[Mutant], results: Results) -> str:
    """Return counts by group and kind, and the survivors with their reasons, as Markdown."""
    rows = {mutant: results.of(mutant) for mutant in all_of}
    lines = ["| mutants | in all | run | survive | % | s each |", "| --- " + "| ---: " * 5 + "|"]
    keys = list(dict.fromkeys((m.kind, m.group) for m in all_of))
    for kind, group in [*keys, *((kind, "all") for kind in dict.fromkeys(k for k, _ in keys))]:
        within = [m for m in all_of if m.kind == kind and group in (m.group, "all")]
        ran = [row for m in within if (row := rows[m])]
        count = Counter(row["verdict"] for row in ran)
        seconds = sum(row["seconds"] for row in ran) / max(len(ran), 1)
        share = 100 * count["survived"] / max(len(ran), 1)
        lines.append(
            f"| {kind}, {group} | {len(within)} | {len(ran)} | {count['survived']} "
            f"| {share:.1f} | {seconds:.1f} |"
        )
    for mutant, row in rows.items():
        if row and row["verdict"] == "survived":
            reason = f" ({mutant.reason})" if mutant.reason else ""
            lines.append(f"- lives: {mutant.name}: {mutant.change}{reason}")
    return "\n".join(lines)


def verdict(all_of: list[Mutant], results: Results) -> str:
    """Return what is wrong with the mutants by hand; nothing if few live, each with a reason."""
    hand = [mutant for mutant in all_of if mutant.kind == "hand"]
    rows = [(mutant, results.of(mutant)) for mutant in hand]
    failed = [mutant.name for mutant, row in rows if row is None]
    living = [mutant for mutant, row in rows if row and row["verdict"] == "survived"]
    silent = [mutant.name for mutant in living if not mutant.reason]
    many = len(living) > SHARE * max(len(hand), 1) and len(hand) >= 1 / SHARE
    return "\n".join(
        ([f"not run: {', '.join(failed)}"] if failed else [])
        + ([f"live without a reason: {', '.join(silent)}"] if silent else [])
        + ([f"{len(living)} of {len(hand)} live, at most {SHARE:.0%} may"] if many else [])
    )


def main() -> None:
    """Run what is asked for; without arguments everything."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("--kind", choices=("hand", "random", "all"), default="all")
    parser.add_argument("--group", action="append", help="only this group; may be repeated")
    parser.add_argument("--name", action="append", help="only mutants with this in their names")
    parser.add_argument("--jobs", type=int, default=2, help="mutants at once")
    parser.add_argument("--results", type=Path, default=ROOT / ".mutants.json")
    parser.add_argument("--fresh", action="store_true", help="forget earlier results")
    parser.add_argument("--quick", action="store_true", help="only the first tests of a module")
    parser.add_argument("--report", action="store_true", help="only report")
    words = parser.parse_args()
    os.nice(max(0, 19 - os.nice(0)))
    if words.fresh:
        words.results.unlink(missing_ok=True)
    results = Results(words.results)
    chosen = [group for group in groups() if not words.group or group.name in words.group]
    all_of = [
        mutant
        for mutant in mutants(chosen, words.kind)
        if not words.name or any(part in mutant.name for part in words.name)
    ]
    if words.quick:
        all_of = [replace(mutant, tests=mutant.tests[:1]) for mutant in all_of]
    todo = [mutant for mutant in all_of if results.of(mutant) is None]
    if todo and not words.report:
        preload()
        run(todo, results, words.jobs)
    print(report(all_of, results))
    sys.exit(verdict(all_of, results) or 0)


if __name__ == "__main__":
    main()
