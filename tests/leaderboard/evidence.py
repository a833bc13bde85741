"""Made-up scores that follow from made-up evidence, and boards of them."""

import copy
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from racines_leaderboard.board.collect import collect
from racines_leaderboard.board.pinning import pin_board
from racines_leaderboard.records.ranges import range_of
from racines_models.statistics import Evidence
from racines_models.statistics.sets import set_replicates
from tests.leaderboard.conftest import DIGEST, agent_scores, generator_scores

ENDS = {
    "ssim": (0.2, 0.8),
    "psnr": (10.0, 30.0),
    "fid": (300.0, 10.0),
    "kid": (0.3, 0.01),
    "pose_error_mm": (80.0, 4.0),
    "success_true": (0.1, 0.9),
    "spl": (0.1, 0.9),
    "final_grade": (1.0, 8.0),
}
"""What an entry of quality 0 and one of quality 1 have."""
STATISTICS = {"fid": "set", "kid": "set", "pose_error_mm": "median", "success_true": "rate"}
GENERATOR, AGENT = tuple(ENDS)[:5], tuple(ENDS)[5:]
Quality = float | Mapping[str, float]


def evidence(
    names: tuple[str, ...], quality: Quality, seed: int = 0, trainings: int = 3, units: int = 8,
    spread: float = 0.02,
) -> Evidence:  # fmt: skip
    """Return figures of two items a unit; units are hard and easy for all entries alike."""
    made = Evidence()
    unit = np.repeat(np.arange(units), 2)
    hard = np.random.default_rng(99).normal(0, 0.03, units)[unit]
    chance = np.random.default_rng(seed)
    for name in names:
        zero, one = ENDS[name]
        good = quality if isinstance(quality, int | float) else quality.get(name, 0.5)
        noise = chance.normal(0, spread, (trainings, 1, len(unit)))
        values = zero + (one - zero) * (good + hard + noise)
        kind = STATISTICS.get(name, "mean")
        if kind == "set":
            whole = [lambda keep, row=row[0]: float(row[keep].mean()) for row in values]
            made.add_set(name, set_replicates(whole, unit))
        else:
            values = (values > np.quantile(values, 1 - good)) * 1.0 if kind == "rate" else values
            made.add(name, kind, values, np.arange(len(unit)), unit)
    return made


def with_evidence(scores: dict[str, Any], figures: Evidence, trained: bool) -> dict[str, Any]:
    """Return scores that say what their evidence does."""
    scores = copy.deepcopy(scores)
    for name, each in figures.figures.items():
        scores["metrics"][name] = each.interval(*range_of(name)).to_json()
    trainings = len(next(iter(figures.figures.values())).replicates().whole)
    return scores | {"runs": trainings, "trained": trained}


def write(folder: Path, scores: dict[str, Any], figures: Evidence | None = None) -> Path:
    """Write scores, and their evidence beside them, under their name; return the JSON's path."""
    name = scores.get("generator") or scores.get("agent")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.json"
    if figures is not None:
        scores = scores | {"evidence": figures.write(path.with_suffix(".parquet"))}
    path.write_text(json.dumps(scores))
    return path


def generator(folder: Path, name: str, quality: Quality, seed: int = 0, **how: Any) -> Path:
    """Write a generator's scores as a scoring leaves them."""
    trained = how.pop("trained", True)
    figures = evidence(GENERATOR, quality, seed, **how)
    return write(folder, with_evidence(judged(generator_scores(name)), figures, trained), figures)


def agent(folder: Path, name: str, quality: Quality, seed: int = 0, **how: Any) -> Path:
    """Write an agent's scores as an evaluation leaves them."""
    trained, sees = how.pop("trained", True), how.pop("sees", "image")
    figures = evidence(AGENT, quality, seed, **how)
    scores = judged(agent_scores(name)) | {"sees": sees}
    return write(folder, with_evidence(scores, figures, trained), figures)


def judged(scores: dict[str, Any]) -> dict[str, Any]:
    """Add what scored it."""
    kinds = ("inception", "grader", "pose") if "generator" in scores else ("grader",)
    scores["extractors"] = {kind: {"sha256": DIGEST} for kind in kinds}
    if "generator" in scores:
        scores["dataset"]["sample"] = DIGEST
    return scores


def anchors(folder: Path) -> None:
    """Write the scores of both tracks' anchors."""
    for name, quality in (("mean-image", 0.0), ("noise-ceiling", 1.0)):
        generator(folder / "g", name, quality, trainings=1, spread=0.0, trained=False)
    for name, quality, sees in (("random", 0.05, "nothing"), ("planner", 0.95, "truth")):
        agent(folder / "a", name, quality, trainings=1, trained=False, sees=sees)


def pinned(folder: Path, board: str = "b") -> Path:
    """Make a pinned board of its anchors alone; return the folder of results."""
    anchors(folder / "anchors")
    scores = [folder / "anchors" / track for track in "ga"]
    collect(scores, folder / "results", folder / "none", board)
    pin_board(folder / "results", board)
    return folder / "results"
