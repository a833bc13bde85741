"""The evidence of a record: the Parquet file beside it, of the figures that its scores rest on."""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_leaderboard.records.pins import Pin, anchored
from racines_leaderboard.records.ranges import range_of
from racines_leaderboard.records.tracks import Track
from racines_models.statistics import Evidence, Figures

CLOSE = 1e-9
"""What a value may differ by from that of its evidence, relative: the last bits of a sum."""


def evidence_path(path: Path, scores: dict[str, Any]) -> Path | None:
    """Return the evidence that lies beside a scores file or a record; None where it claims none.

    Raises:
        RacinesError: another name than the scores', no such file, or another sha256.
    """
    told = scores.get("evidence")
    if told is None:
        return None
    beside = path.with_suffix(".parquet")
    if told["file"] != beside.name:
        raise RacinesError(f"{path}: evidence.file: {told['file']!r}, expected {beside.name!r}")
    if not beside.is_file():
        raise RacinesError(f"{beside}: no evidence, which {path.name} names; score it again")
    if (found := sha256_file(beside)) != told["sha256"]:
        raise RacinesError(
            f"{beside}: sha256 {found[:12]}…, not the {told['sha256'][:12]}… that {path.name} "
            "names; score it again"
        )
    return beside


def read_evidence(
    path: Path, scores: dict[str, Any], track: Track, pin: Pin | None
) -> Evidence | None:
    """Read the evidence beside scores; refuse what the scores do not follow from.

    Raises:
        RacinesError: as `evidence_path`; a damaged file; a ranked metric that it lacks; a value or
            an interval that is not the scores'; other trainings, or other items than the board's.
    """
    beside = evidence_path(path, scores)
    if beside is None:
        return None
    evidence = Evidence.read(beside)
    for name, figures in evidence.figures.items():
        _check_figures(path, name, scores["metrics"].get(name), figures)
    part = anchored(scores, track, pin)
    for name in track.ranked_by:
        valued = (scores["metrics"].get(name) or {}).get("value") is not None
        if name not in evidence.figures:
            if valued:
                raise RacinesError(f"{beside}: has no figures of {name}; score it again")
            continue
        figures = evidence.figures[name]
        trainings = figures.trainings
        if scores.get("runs", trainings) != trainings:
            raise RacinesError(
                f"{path}: runs: {scores['runs']}; {beside.name} has {name} of {trainings} "
                "trainings; score it again"
            )
        wanted = (part or {}).get("items")
        if wanted is not None and figures.whole is None and items_sha256(figures) != wanted:
            raise RacinesError(
                f"{beside}: {name}: other items or units than those of the board's anchors; score "
                "it on the board's"
            )
    return evidence


def _check_figures(path: Path, name: str, metric: Any, figures: Figures) -> None:
    """Refuse a metric whose value or interval is not that of its figures."""
    told = {key: (metric or {}).get(key) for key in ("value", "low", "high", "n")}
    # Cut at what the metric can be, or, where whoever scored it did not, as it is.
    found = figures.interval(*range_of(name))
    differing = [key for key in told if not _same(told[key], getattr(found, key))]
    if differing:
        uncut = figures.interval()
        differing = [key for key in differing if not _same(told[key], getattr(uncut, key))]
    for key in differing[:1]:
        raise RacinesError(
            f"{path}: metrics.{name}.{key}: {told[key]}; its evidence has {getattr(found, key)}; "
            "score it again"
        )


def _same(a: float | None, b: float | None) -> bool:
    if a is None or b is None:
        return a is b
    return abs(a - b) <= CLOSE * max(1.0, abs(b))


def items_sha256(figures: Figures) -> str:
    """Return the sha256 of which items figures are of, and in which units."""
    assert figures.items is not None and figures.units is not None
    pairs = np.stack([figures.items, figures.units]).astype("<i4")
    return hashlib.sha256(pairs.tobytes()).hexdigest()


def items_of(evidence: Evidence | None, track: Track) -> str | None:
    """Return the digest of the items that the ranked metrics are of; None where none has items."""
    for name in track.ranked_by:
        figures = evidence.figures.get(name) if evidence is not None else None
        if figures is not None and figures.whole is None:
            return items_sha256(figures)
    return None


def distinct_trainings(evidence: Evidence) -> int:
    """Return how many trainings differ from each other in any figure: a copy is none of its own."""
    figures = evidence.figures.values()
    count = max((each.trainings for each in figures), default=0)
    seen = set()
    for training in range(count):
        parts = []
        for each in figures:
            values = each.whole.without if each.whole is not None else each.values
            assert values is not None
            parts.append(values[training].tobytes() if training < len(values) else b"")
            if each.whole is not None:
                parts.append(each.whole.whole[training : training + 1].tobytes())
        seen.add(b"|".join(parts))
    return len(seen)
