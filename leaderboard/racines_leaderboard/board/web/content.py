"""What the page shows of boards: sections of ranked rows, their axes, and every pair compared."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

from racines_data.escape import visible
from racines_leaderboard.board.collect import boards, read_board
from racines_leaderboard.board.rank import SCORE, Ranked, Record, by_task, rank
from racines_leaderboard.board.standing import is_bound
from racines_leaderboard.board.table import Table, ranked_table, shown_columns, shown_metric, steady
from racines_leaderboard.records.columns import PERCENT, Column, Track
from racines_leaderboard.records.tracks import board_tracks
from racines_models.statistics.intervals import LEVEL, Interval, difference

FIRST = ("patients", "beating")
"""Boards that stand before the others."""


@dataclass(frozen=True)
class Section:
    """One ranking of a board."""

    board: str
    title: str
    track: Track
    ranking: list[Ranked]
    columns: list[Column]
    table: Table
    """The same ranking as the Markdown has it; its notes stand below the rows."""

    @property
    def names(self) -> list[str]:
        """The systems, best first."""
        return [each.record["name"] for each in self.ranking]


def ordered(names: Sequence[str]) -> list[str]:
    """Return boards as the page has them: patients first, then by name."""
    first = [name for name in FIRST if name in names]
    return [*first, *sorted(set(names) - set(first))]


def read_sections(results: Path) -> dict[str, list[Section]]:
    """Return the rankings of all boards, by board.

    Raises:
        RacinesError: as `read_board`.
    """
    return {name: sections_of(name, read_board(results, name)) for name in ordered(boards(results))}


def sections_of(board: str, content: dict[str, list[Record]]) -> list[Section]:
    """Return the rankings of one board."""
    found = []
    for track in board_tracks():
        for task, records in by_task(content[track.name]).items():
            ranking = rank(track, records)
            columns = shown_columns((SCORE, *track.columns), ranking)
            title = " · ".join(part for part in (track.name, task) if part)
            found.append(
                Section(board, title, track, ranking, columns, ranked_table(title, track, ranking))
            )
    return found


def axis_of(column: Column, ranking: Sequence[Ranked]) -> tuple[float, float]:
    """Return the ends of a column's common axis, in the unit shown, with all intervals on it."""
    ends = []
    for ranked in ranking:
        if (metric := shown_metric(ranked.record, column)) is not None:
            told = (metric["value"], metric["low"], metric["high"])
            ends += [end * column.scale for end in told if end is not None]
    low, high = min(ends, default=0.0), max(ends, default=1.0)
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def kind_of(ranked: Ranked) -> str:
    """Return `bound`, `learned`, or `other` for a method that nobody trains."""
    if is_bound(ranked.record):
        return "bound"
    return "learned" if ranked.record["scores"].get("trained", True) else "other"


def pairs(section: Section) -> Iterator[dict[str, Any]]:
    """Yield every two systems of a ranking compared, as the ranking compares them."""
    for (i, first), (j, second) in combinations(enumerate(section.ranking), 2):
        told = compared(first, second)
        text = sentence(first, second, told, section.track)
        ends = {} if told is None else {"value": told.value, "low": told.low, "high": told.high}
        figures = {key: None if end is None else steady(end) for key, end in ends.items()}
        yield {"rows": [i, j], "text": text, **figures}


def compared(first: Ranked, second: Ranked) -> Interval | None:
    """Return the paired difference of two scores, or None where one has no evidence."""
    ours, theirs = first.standing.replicates, second.standing.replicates
    if ours is None or theirs is None:
        return None
    return difference(ours, theirs, "score difference")


def sentence(first: Ranked, second: Ranked, told: Interval | None, track: Track) -> str:
    """Say in one sentence how two systems compare; the first stands above the second."""
    a, b = (visible(each.record["name"]) for each in (first, second))
    if told is None:
        without = [visible(each.record["name"]) for each in (first, second)
                   if each.standing.replicates is None]  # fmt: skip
        return f"{a} and {b} cannot be paired: no evidence or anchors of {' and '.join(without)}."
    counts = dict.fromkeys(each.standing.trainings or 0 for each in (first, second))
    trained = f"{' and '.join(map(str, counts))} training{'' if list(counts) == [1] else 's'}"
    basis = f"{told.units:,} {track.unit}, {trained}"
    apart = f"{abs(told.value):.3f} {'lower' if told.value < 0 else 'higher'} than {b}"
    if told.low is None or told.high is None:
        return f"{a} scores {apart} ({basis}); the difference has no interval."
    between = f"{PERCENT} interval of the paired difference {told.low:+.3f} to {told.high:+.3f}"
    if told.level is not None and told.level < LEVEL:
        between += f", found to cover {100 * told.level:.0f} %"
    return (
        f"{a} scores {apart} ({between}; {basis}): {_meaning(a, b, told)}{_apart(first, second)}."
    )


def _meaning(first: str, second: str, told: Interval) -> str:
    if told.low is not None and told.low > 0:
        return f"the interval leaves out 0, so {first} has the higher score"
    if told.high is not None and told.high < 0:
        return f"the interval leaves out 0, so {second} has the higher score"
    return "the interval holds 0, so neither is ahead"


def _apart(first: Ranked, second: Ranked) -> str:
    """Say which of two systems takes no place, and why."""
    found = [f"{visible(each.record['name'])} ({each.standing.why})"
             for each in (first, second) if each.place is None]  # fmt: skip
    return f"; without a place: {' and '.join(found)}" if found else ""
