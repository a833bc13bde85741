"""Pinning a board: making its file of two records a track, those of the two anchors.

Where the truth's figures are known it stands at 1 itself, and one record is enough.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.files import locked, write_json
from racines_leaderboard.board.collect import made_elsewhere, read_record, read_scores
from racines_leaderboard.board.evidence import items_of, read_evidence
from racines_leaderboard.records.pins import (
    FILE,
    SCHEMA,
    Pin,
    check_fits,
    hashes_of,
    read_pin,
    recipe_of,
)
from racines_leaderboard.records.schema import check
from racines_leaderboard.records.tracks import TRACKS, Track
from racines_models.provenance import SPEEDS, result_sha256

OPTIONAL = ("diversity",)
"""Metrics that a sound record may lack: predictions of one seed say nothing of it."""
Found = dict[Path, dict[str, Any]]
"""Scores by the file that they were read from."""


def pin_board(
    results: Path, board: str, folders: Sequence[Path] = (), force: bool = False
) -> list[str]:
    """Write a board's file from its anchors' records; return what changed, a line a field.

    With `folders`, from the scores there, which need not be on the board yet; a track of which
    there are none keeps its pin.

    Raises:
        RacinesError: no pair of anchors; two that differ in what a board has one of; an anchor at 1
            that is no better than that at 0; or, without `force`, a file that says something else.
    """
    pin = make_pin(board, found_scores(results, board, folders))
    path = results / board / FILE
    with locked(results):
        before = read_pin(results, board)
        if folders:
            kept = {track.name: (before or {}).get(track.name) for track in TRACKS}
            pin |= {name: held for name, held in kept.items() if held and name not in pin}
        changes = list(_changes(before or {}, pin))
        if before is not None and changes and not force:
            raise RacinesError(
                f"{path}: the board is pinned, and {len(changes)} fields would change "
                f"({changes[0]}{', …' if changes[1:] else ''}): --force to pin it anew"
            )
        if changes:
            write_json(path, pin)
    return changes


def found_scores(results: Path, board: str, folders: Sequence[Path] = ()) -> dict[str, Found]:
    """Return scores by track: a board's records, or those in folders that were made for it."""
    found: dict[str, Found] = {track.name: {} for track in TRACKS}
    if folders:
        others = made_elsewhere(list(folders), board)
        for path in (path for folder in folders for path in sorted(folder.glob("*.json"))):
            if path not in others:
                scores, track = read_scores(path)
                found[track.name][path] = scores
        return found
    for track in TRACKS:
        for path in sorted((results / board / track.name).glob("*.json")):
            found[track.name][path] = read_record(path, board, track)["scores"]
    return found


def misfits(results: Path, board: str) -> list[str]:
    """Return why records of a board do not fit what it is pinned to, a line a record."""
    pin, lines = read_pin(results, board), []
    for track in TRACKS:
        for path in sorted((results / board / track.name).glob("*.json")):
            try:
                check_fits(read_record(path, board, track)["scores"], track, pin, str(path))
            except RacinesError as error:
                lines.append(str(error))
    return lines


def make_pin(board: str, found: dict[str, Found]) -> Pin:
    """Return a board's file, of the scores of each track's anchors.

    Raises:
        RacinesError: as `pin_board`.
    """
    parts = {each.name: _how(each)(found[each.name], each) for each in TRACKS}
    kept = {name: part for name, part in parts.items() if part is not None}
    if not kept:
        tracks = [track for track in TRACKS if found[track.name]] or TRACKS
        pairs = " or ".join(dict.fromkeys(" and ".join(track.anchors) for track in tracks))
        raise RacinesError(f"board {board}: no anchors: score {pairs} first")
    pin = json.loads(json.dumps({"schema": SCHEMA, "board": board} | kept))
    check(pin, "board", f"board {board}")
    return pin


def _how(track: Track) -> Callable[[Found, Track], Pin | None]:
    if track.steers:
        return _pin_agents
    return _pin_generators if track.exact is None else _pin_motion


def _pin_motion(found: Found, track: Track) -> Pin | None:
    """Return what holds who estimates motion: one anchor, since the truth's errors are known."""
    floors = _named(found, track, track.anchors[0])
    if not floors:
        return None
    (path,) = only = {floors[0]: found[floors[0]]}
    data = found[path]["dataset"]
    part: Pin = {key: data[key] for key in ("recipe_digest", "config", "split", "sweeps")}
    part |= {"settings": found[path]["settings"], "metrics": _metrics([found[path]])}
    return part | _anchors(track, only)


def _pin_generators(found: Found, track: Track) -> Pin | None:
    pair = [_named(found, track, name) for name in track.anchors]
    if not all(pair):
        return None
    zero, one = (paths[0] for paths in pair)
    both = {path: found[path] for path in (zero, one)}
    part: Pin = {"recipe_digest": _shared("recipe", recipe_of, both)}
    for key in ("split", "sample"):
        value = _shared(key, lambda scores, key=key: scores["dataset"].get(key), both)
        part |= {} if value is None else {key: value}
    part["judges"] = _shared("judges", lambda s: hashes_of(s, False), both)
    part["extractors"] = _shared("extractors", lambda s: hashes_of(s, True), both)
    part["metrics"] = _metrics(list(both.values()))
    return part | _anchors(track, both)


def _pin_agents(found: Found, track: Track) -> Pin | None:
    pairs, tasks = {}, []
    floors, ceilings = (_named(found, track, name) for name in track.anchors)
    for zero in floors:
        for one in ceilings:
            if _place(found[zero]) == _place(found[one]):
                pairs[_place(found[zero])] = zero, one
    if not pairs:
        return None
    used = {path: found[path] for pair in pairs.values() for path in pair}
    for (view, backend), (zero, one) in sorted(pairs.items()):
        both = {path: found[path] for path in (zero, one)}
        task: Pin = {"view": view, "backend": backend}
        definition = _shared("task", lambda s: s["task"].get("definition"), both)
        task |= {} if definition is None else {"definition": definition}
        if track.own_starts:
            task["start_set"] = _shared("start set", _starts, both)
        tasks.append(task | _anchors(track, both))
    starts = {} if track.own_starts else {"start_set": _shared("start set", _starts, used)}
    return {
        "recipe_digest": _shared("recipe", recipe_of, used),
        "judges": _shared("judges", lambda s: hashes_of(s, False), used),
        "metrics": _metrics(list(used.values())),
        **starts,
        "tasks": tasks,
    }


def _starts(scores: dict[str, Any]) -> Any:
    return scores["task"]["start_set"]


def _place(scores: dict[str, Any]) -> tuple[str, str]:
    return scores["task"]["view"], scores["task"]["backend"]


def _named(found: Found, track: Track, method: str) -> list[Path]:
    """Return where the scores of a method lie; runs of one method may have names of their own."""
    return [p for p, s in found.items() if s.get("submission", s[track.subject]) == method]


def _shared(what: str, of: Any, found: Found) -> Any:
    """Return what all scores have in common, and refuse two that differ."""
    (first, value), *others = ((path, of(scores)) for path, scores in found.items())
    for path, other in others:
        if other != value:
            raise RacinesError(f"{path}: {what}: {other}; {first} has {value}: score both alike")
    return value


def _metrics(documents: list[dict[str, Any]]) -> list[str]:
    """Return the metrics that all have, but for speeds and those of installed packages."""
    from racines_models.scores.plugin import installed_metrics

    others = {*SPEEDS, *OPTIONAL, *(metric.name for metric in installed_metrics())}
    named = [name for name in documents[0]["metrics"] if name not in others]
    return [name for name in named if all(name in each["metrics"] for each in documents)]


def _anchors(track: Track, both: Found) -> Pin:
    """Return the anchors of two scores, or of one beside the truth, and the items of both."""
    paths, values = list(both), {}
    zero, one = paths[0], paths[-1]
    for column in track.ranked_columns():
        ends = [_value(path, scores, column.key) for path, scores in both.items()]
        ends += [] if track.exact is None else [track.exact]
        if not column.improves(ends[1], ends[0]):
            raise RacinesError(
                f"{one}: metrics.{column.key}.value: {ends[1]:g} is no better than the "
                f"{ends[0]:g} of {zero}: no anchors for a score"
            )
        values[column.key] = ends
    told = ({"name": each[track.subject], "scores": result_sha256(each)} for each in both.values())
    entries = dict(zip(("zero", "one"), told, strict=False))
    items = {
        items_of(read_evidence(path, scores, track, None), track) for path, scores in both.items()
    } - {None}
    if len(items) > 1:
        raise RacinesError(f"{one}: its evidence is of other items than {zero}: score both alike")
    return ({"items": items.pop()} if items else {}) | {"anchors": entries | {"values": values}}


def _value(path: Path, scores: dict[str, Any], key: str) -> float:
    value = (scores["metrics"].get(key) or {}).get("value")
    if value is None:
        raise RacinesError(
            f"{path}: metrics.{key}: no value to anchor at: score it again with "
            "judges, without --no-grader and --no-pose"
        )
    return value


def _changes(before: Any, after: Any, place: str = "") -> Iterator[str]:
    """Yield what differs of two documents, a line a field."""
    if isinstance(before, dict) and isinstance(after, dict):
        for key in dict.fromkeys((*before, *after)):
            inner = f"{place}.{key}" if place else key
            yield from _changes(before.get(key), after.get(key), inner)
    elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        for i, pair in enumerate(zip(before, after, strict=True)):
            yield from _changes(*pair, f"{place}.{i}")
    elif before != after:
        yield f"{place}: {_shown(before)} -> {_shown(after)}"


def _shown(value: Any) -> str:
    text = "nothing" if value is None else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 80 else f"{text[:77]}…"
