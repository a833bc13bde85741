"""Every leaf of a record: held against what was made again, or declared to be informative.

A leaf is a number, a text, a truth value, null or an empty container, with its place in dots:
`scores.metrics.fid.settings.features`. What follows from code, settings and data (rules, notes,
units, seeds, names) must be what it is when the record is made again. Keys that were dropped or
added count. The numbers of metrics, digests and hashes have checks of their own.
"""

import re
from collections.abc import Iterator
from typing import Any

from racines_leaderboard.audit.verdicts import Verdict, fails, holds
from racines_leaderboard.board.collect import Record

INFORMATIVE = {
    r"scores\.metrics\.(images_per_second_\d+|latency)(\..+)?": "speeds: they are the machine's",
    r"scores\.metrics\.seconds_to_adapt(\..+)?": "a time: it is the machine's",
    r"scores\.seconds": "how long scoring took",
    r"scores\.environment(\..+)?": "the machine: another one is held within the stated tolerance",
    r"scores\.code\.commit": "the numbers are made again by the code that is here",
    r"submission\.(authors|method|description|licence|url|paper)(\..+)?": "what its authors say",
    r"submission\.(seeds|code|training)(\..+)?": "how its authors say that it was made",
    r"submission\.tier": "the tier asked for; the one reached is derived",
}
"""Leaves that no rank, tier or verdict rests on, and why. Those of a submission must still be
those of its `submission.yaml`."""
NUMBERS = r"(metrics|by_(seed|pathology|stratum)\.[^.]+)\.[^.]+\.(value|low|high|n)"
ELSEWHERE = (
    r"extractors\..+|(weights|evidence)(\..+)?",
    r"(dataset|learned_from)\.digest|dataset\.board|board|code\.version|agent|generator|motion",
)
"""Leaves of scores that have a check of their own."""
OF_TRAININGS = (
    r"runs|(seeds|trainings|explained)(\..+)?|(metrics|by_(seed|pathology|stratum)\.[^.]+)\.[^.]+\.settings\.(interval|level|units|trainings|trajectories|by_set)"
    r"(\..+)?"
)
"""Those that differ where some of the trainings were made again; the evidence tells them."""
OF_METRIC = re.compile(r"(metrics|by_(?:seed|pathology|stratum)\.[^.]+)\.([^.]+)\..+")
"""A leaf of a metric: of which group it is, and of which metric."""
OF_SET = re.compile(r"(metrics|by_(?:seed|pathology|stratum)\.[^.]+)\.[^.]+\.settings\.by_set\..+")
"""What was measured of one start set, in the settings of a metric."""
MISSING = object()


def leaves(document: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """Give each leaf of a JSON document, its place first."""
    if isinstance(document, dict | list) and document:
        each = document.items() if isinstance(document, dict) else enumerate(document)
        for key, value in each:
            yield from leaves(value, f"{place}.{key}" if place else str(key))
    else:
        yield place, document


def informative(place: str) -> str | None:
    """Return why nothing rests on a leaf of a record; None for those on which something does."""
    return next((why for one, why in INFORMATIVE.items() if re.fullmatch(one, place)), None)


def compare_leaves(
    record: Record, made: dict[str, Any], bounds: dict[str, float], partly: bool = False
) -> Iterator[Verdict]:
    """Hold what a record's scores say beside their numbers against scores made again.

    Args:
        record: The record.
        made: The scores.
        bounds: How far what was measured of each start set may be off, by metric; or a number in
            another part, by the part. Settings are what they are on every machine.
        partly: Only some of the record's trainings were made again.
    """
    from racines_models.scores.plugin import installed_metrics

    # A package that is installed here adds metrics that the record cannot know.
    added = {metric.name for metric in installed_metrics()}
    claimed, here = dict(leaves(record["scores"])), dict(leaves(made))
    if "extractors" in here and record["scores"].get("extractors"):
        del here["extractors"]  # those that it names are not here
    apart, equal = [], 0
    # Whether a metric that was not made again speaks against a record, its numbers tell.
    unmade = {_metric(place) for place in claimed} - {_metric(place) for place in here}
    for place in dict.fromkeys((*claimed, *here)):
        group, metric = _metric(place)
        stated, found = claimed.get(place, MISSING), here.get(place, MISSING)
        if _elsewhere(place, partly, stated) or (group, metric) in unmade or metric in added:
            continue
        part = metric if group == "metrics" else place.partition(".")[0]
        measured = not metric or OF_SET.fullmatch(place)
        if same(stated, found, bounds.get(part, 0.0) if measured else 0.0):
            equal += 1
        else:
            apart.append((place, stated, found))
    for place, stated, found in apart:
        why = "as it is when it is made again"
        why = "not there when it is made again" if found is MISSING else why
        why = "left out of the record" if stated is MISSING else why
        yield fails(f"scores.{place}", why, *(None if x is MISSING else x for x in (stated, found)))
    if not apart:
        yield holds("scores", f"{equal} further leaves are as they are when it is made again")


def _metric(place: str) -> tuple[str, str]:
    """Return the group and the name of the metric that a leaf is of; both empty for others."""
    found = OF_METRIC.fullmatch(place)
    return (found[1], found[2]) if found else ("", "")


def _elsewhere(place: str, partly: bool, stated: Any) -> bool:
    if informative(f"scores.{place}") or (partly and re.fullmatch(OF_TRAININGS, place)):
        return True
    if stated is MISSING and re.fullmatch(NUMBERS, place):
        return False
    return any(re.fullmatch(pattern, place) for pattern in (NUMBERS, *ELSEWHERE))


def same(stated: Any, found: Any, bound: float = 0.0) -> bool:
    """Return whether two leaves say the same; true is not 1, and a float has a bound."""
    if isinstance(stated, bool) != isinstance(found, bool):
        return False
    if isinstance(stated, float) and isinstance(found, float):
        return abs(stated - found) <= bound
    return stated == found
