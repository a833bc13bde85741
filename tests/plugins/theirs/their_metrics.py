"""Two metrics, of images and of features, and a column of the board that is no metric."""

from racines_leaderboard.records.tracks import Column
from racines_models.scores.plugin import Metric


def _offset(drawn, truth):
    return (drawn.images.double() - truth.images.double()).mean((1, 2)).abs()


OFFSET = Metric("offset", "Gray offset", "lower", _offset, unit="gray", digits=1, rule="mean gray")
SHIFT = Metric(
    "shift", "Feature shift", "lower", lambda a, b: (a.mean(0) - b.mean(0)).norm(), features=True
)


def _seeds(record):
    return {"value": len(record["scores"]["seeds"]), "low": None, "high": None, "n": 1}


SEEDS = Column("seeds", "Seeds drawn", "none", 0, value=_seeds)
