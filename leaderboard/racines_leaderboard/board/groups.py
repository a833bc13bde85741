"""What may stand in one ranking: results of one task."""

from racines_leaderboard.board.rank import Ranked, Record, is_bound, rank
from racines_leaderboard.records.tracks import Track

SHOWN = {
    "image": " from the image",
    "params": " from the pose",
    "multimodal": " from image and pose",
}


def by_task(records: list[Record]) -> dict[str, list[Record]]:
    """Group the results that compare: generators all together, agents by task.

    A task is a view, what is shown of it, and what draws the images. Bounds stand in every group of
    their view and backend; in one of their own where there is no other.
    """
    groups: dict[tuple[str, str, str], list[Record]] = {}
    bounds: dict[tuple[str, str], list[Record]] = {}
    for record in records:
        task = record["scores"].get("task")
        view, backend, shown = (
            (task["view"], task["backend"], task["observation"]) if task else ("", "", "")
        )
        if is_bound(record):
            bounds.setdefault((view, backend), []).append(record)
        else:
            groups.setdefault((view, backend, shown), []).append(record)
    for (view, backend), floor_and_ceiling in bounds.items():
        held = [group for key, group in groups.items() if key[:2] == (view, backend)]
        for group in held or [groups.setdefault((view, backend, ""), [])]:
            group.extend(floor_and_ceiling)
    return {_task_title(*key): group for key, group in sorted(groups.items())}


def rankings(track: Track, records: list[Record]) -> list[Ranked]:
    """Return the ranked results of all tasks, one after another; a bound in the first alone."""
    first: dict[str, Ranked] = {}
    for group in by_task(records).values():
        for ranked in rank(track, group):
            first.setdefault(ranked.record["name"], ranked)
    return list(first.values())


def _task_title(view: str, backend: str, shown: str) -> str:
    return f"{view}{SHOWN.get(shown, '')}, {backend} backend" if view else ""
