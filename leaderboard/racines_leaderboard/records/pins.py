"""A board's own file, `results/<board>/board.json`: what each of its records is held to.

Dataset recipe, split, sample, judges and feature extractor by sha256, the metrics that a record
has, the start set, and the anchors: the values of the ranked metrics at score 0 and at score 1.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_envs.robots.arm import FREE
from racines_leaderboard.records.schema import read_json
from racines_leaderboard.records.tracks import Track

FILE = "board.json"
SCHEMA = "racines.board/1"
EXTRACTORS = ("inception",)
"""Of what a scores file calls extractors: those that are no judges."""
OWN = ("guide",)
"""Those that a system brings with it, and nobody is judged by."""
JUDGED = "score it again with the published judges"
Pin = dict[str, Any]


def read_pin(results: Path, board: str) -> Pin | None:
    """Read a board's file; None where the board has none, and so is not pinned.

    Raises:
        RacinesError: a damaged file, or one of another board.
    """
    path = results / board / FILE
    if not path.is_file():
        return None
    pin = read_json(path, "board")
    if pin["board"] != board:
        raise RacinesError(f"{path}: board: {pin['board']!r}, expected {board!r} by its place")
    return pin


def recipe_of(scores: dict[str, Any]) -> str | None:
    """Return the recipe digest of the dataset, or the phantom, that scores rest on."""
    return (scores.get("dataset") or scores.get("phantom") or {}).get("recipe_digest")


def hashes_of(scores: dict[str, Any], extractors: bool) -> dict[str, str]:
    """Return the sha256 of the feature extractors, or of the judges, by kind."""
    found = scores.get("extractors") or {}
    return {
        kind: about["sha256"]
        for kind, about in found.items()
        if kind not in OWN and (kind in EXTRACTORS) == extractors and about.get("sha256")
    }


def task_of(scores: dict[str, Any], pin: Pin) -> Pin | None:
    """Return what a board pins of an agent's task, or None where its anchors leave it out."""
    place = tuple(scores["task"][key] for key in ("view", "backend"))
    return next((task for task in pin["tasks"] if (task["view"], task["backend"]) == place), None)


def anchored(scores: dict[str, Any], track: Track, pin: Pin | None) -> Pin | None:
    """Return the part of a board's file with the anchors and items of some scores, or None."""
    part = (pin or {}).get(track.name)
    return task_of(scores, part) if part is not None and "tasks" in part else part


def check_fits(scores: dict[str, Any], track: Track, pin: Pin | None, where: str) -> None:
    """Refuse scores that are not made on what the board is pinned to, and those with an arm.

    Raises:
        RacinesError: the first field that differs, the board's value, and the remedy.
    """
    if track.steers and (robot := scores["task"].get("robot", FREE)) != FREE:
        raise RacinesError(
            f"{where}: task.robot: {robot}; boards are of free probes: evaluate it without an arm"
        )
    part = (pin or {}).get(track.name)
    if pin is None or part is None:
        return
    for field, found, wanted, remedy in _held(scores, track, part):
        if found != wanted:
            raise RacinesError(
                f"{where}: {field}: {_short(found)}; board {pin['board']} has {_short(wanted)}: "
                f"{remedy}"
            )


def _held(scores: dict[str, Any], track: Track, part: Pin) -> Iterator[tuple[str, Any, Any, str]]:
    """Yield each field, what the scores have there, what the board has, and the remedy."""
    data = scores.get("dataset") or {}
    named = "dataset" if scores.get("dataset") else "phantom"
    recipe = f"score it on the board's {named}"
    yield f"{named}.recipe_digest", recipe_of(scores), part["recipe_digest"], recipe
    for key in ("config", "split", "sample", "sweeps"):
        if key in part:
            frames = "score it on the board's frames, by the settings of its profile"
            yield f"dataset.{key}", data.get(key), part[key], frames
    for key, wanted in part.get("settings", {}).items():
        alike = "score it with the settings of the board's params.yaml"
        yield f"settings.{key}", scores["settings"].get(key), wanted, alike
    hashes = {extractors: hashes_of(scores, extractors) for extractors in (False, True)}
    for kind, wanted in part.get("judges", {}).items():
        yield f"extractors.{kind}.sha256", hashes[False].get(kind), wanted, JUDGED
    for kind, wanted in part.get("extractors", {}).items():
        again = "score it again with the board's feature extractor"
        yield f"extractors.{kind}.sha256", hashes[True].get(kind), wanted, again
    if "tasks" in part:
        task = task_of(scores, part)
        wanted = part.get("start_set") or (task or {}).get("start_set")
        if wanted is not None:
            starts = "evaluate it from the board's starts"
            yield "task.start_set", scores["task"]["start_set"], wanted, starts
        if task is not None and "definition" in task:
            defined = "evaluate it on the board's task"
            yield "task.definition", scores["task"].get("definition"), task["definition"], defined
    metrics = scores["metrics"]
    for name in part["metrics"]:
        if name not in metrics:
            yield f"metrics.{name}", None, "it", f"{JUDGED}, leaving out none"
    for name in track.ranked_by:
        if (metrics.get(name) or {}).get("value") is None:
            yield f"metrics.{name}.value", None, "it", "what ranks has a value: score it again"


def _short(value: Any) -> str:
    """Return a value on a line: a digest by its first letters."""
    if value is None:
        return "not there"
    text = str(value)
    hashed = len(text) == 64 and isinstance(value, str)
    return f"{text[:12]}…" if hashed else text
