"""How the order of a board's systems depends on how its metrics are weighed.

The board's own rule beside other sensible ones, by the records' values alone: every difference
counts here, also one that the intervals do not tell from none.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import rankdata

from racines_leaderboard.board.collect import read_board
from racines_leaderboard.board.pinning import found_scores, make_pin
from racines_leaderboard.board.rank import by_task
from racines_leaderboard.board.standing import anchor, is_bound
from racines_leaderboard.board.table import Table
from racines_leaderboard.records.pins import anchored, read_pin
from racines_leaderboard.records.tracks import TRACKS, Track

Record = dict[str, Any]
Weighing = Callable[[np.ndarray, Track], np.ndarray]
"""(M, N) anchored metrics, higher is better, to (N,) scores, higher is better."""


def _of(*keys: str) -> Weighing:
    def mean(points: np.ndarray, track: Track) -> np.ndarray:
        return points[[track.ranked_by.index(key) for key in keys]].mean(0)

    return mean


def _mean_of_ranks(points: np.ndarray, track: Track) -> np.ndarray:
    return -rankdata(-points, axis=1).mean(0)


COMMON: dict[str, Weighing] = {
    "median": lambda points, track: np.median(points, axis=0),
    "mean of ranks": _mean_of_ranks,
}
# A track that ranks by one metric has no other order.
WEIGHINGS: dict[str, dict[str, Weighing]] = {
    "generators": {
        "score": _of("ssim", "psnr", "fid", "kid", "pose_error_mm"),
        "likeness": _of("ssim", "psnr"),
        "distribution": _of("fid", "kid"),
        **COMMON,
    },
    "patient-generators": {
        "score": _of("ssim", "psnr", "kid", "pose_error_mm", "dice"),
        "likeness": _of("ssim", "psnr"),
        "distribution": _of("kid"),
        "what is seen": _of("pose_error_mm", "dice"),
        **COMMON,
    },
    "turn-generators": {
        "score": _of("ssim", "psnr", "feature_distance"),
        "likeness": _of("ssim", "psnr"),
        "features": _of("feature_distance"),
        **COMMON,
    },
    "agents": {
        "score": _of("success_true", "spl", "final_grade"),
        "success": _of("success_true"),
        "grade": _of("final_grade"),
        **COMMON,
    },
    "motion": {
        "score": _of("gpe", "gle", "lpe", "lle"),
        "global": _of("gpe", "gle"),
        "local": _of("lpe", "lle"),
        **COMMON,
    },
    "tracked-motion": {
        "score": _of("drift_mm", "drift_deg", "step_mm", "step_deg"),
        "place": _of("drift_mm", "step_mm"),
        "angle": _of("drift_deg", "step_deg"),
        "global": _of("drift_mm", "drift_deg"),
        "local": _of("step_mm", "step_deg"),
        **COMMON,
    },
}


def orders(results: Path, board: str) -> dict[str, dict[str, dict[str, Any]]]:
    """Return by task and system: its place by each weighing, the anchored metrics, the score.

    The two anchors are left out. A board without a file takes its own anchors' records.

    Raises:
        RacinesError: a damaged board, or one without anchors.
    """
    content = read_board(results, board)
    pin = read_pin(results, board) or make_pin(board, found_scores(results, board))
    found = {}
    for track in (each for each in TRACKS if each.name in WEIGHINGS):
        for task, records in by_task(content[track.name]).items():
            part = anchored(records[0]["scores"], track, pin)
            if part is not None:
                rows = _ordered(track, records, part["anchors"])
                if rows:
                    found[" · ".join(filter(None, (track.name, task)))] = rows
    return found


def _ordered(
    track: Track, records: list[Record], anchors: dict[str, Any]
) -> dict[str, dict[str, Any]]:
    ends = {anchors[end]["name"] for end in ("zero", "one") if end in anchors}
    records = [record for record in records if record["name"] not in ends]
    if not records:
        return {}
    values = [[r["scores"]["metrics"][k]["value"] for r in records] for k in track.ranked_by]
    points = anchor(np.array(values, np.float64), track, anchors["values"])
    weighed = {name: weigh(points, track) for name, weigh in WEIGHINGS[track.name].items()}
    places = {name: rankdata(-scores.round(12), "min") for name, scores in weighed.items()}
    rows = {}
    for i in np.argsort(-weighed["score"], kind="stable"):
        rows[records[i]["name"]] = {
            "bound": is_bound(records[i]),
            "score": float(weighed["score"][i]),
            "metrics": dict(zip(track.ranked_by, points[:, i].tolist(), strict=True)),
            "places": {name: int(place[i]) for name, place in places.items()},
        }
    return rows


def tables(results: Path, board: str) -> list[Table]:
    """Return the orders of a board as tables, one a task."""
    made = []
    tracks = {track.name: track for track in TRACKS}
    for task, rows in orders(results, board).items():
        track = tracks[task.partition(" · ")[0]]
        labels = [column.label for column in track.ranked_columns()]
        names = [f"by {name}" for name in WEIGHINGS[track.name]]
        lines = tuple(
            (
                f"{name} (bound)" if row["bound"] else name,
                f"{row['score']:.3f}",
                *(f"{value:.2f}" for value in row["metrics"].values()),
                *map(str, row["places"].values()),
            )
            for name, row in rows.items()
        )
        notes = (
            "Metrics are anchored: 0 and 1 are the board's anchors. By: the place that values alone"
            " would give, every difference counted, bounds among the others.",
        )
        title = f"{board} · {task} · other weights"
        made.append(Table(title, ("System", "Score", *labels, *names), lines, notes))
    return made
