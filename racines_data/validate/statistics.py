"""The statistics of the twelve parameters, and whether they are those of the paper's table."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from racines_data.errors import RacinesError
from racines_data.schema import PARAMETERS
from racines_data.views import PAPER_STATISTICS, ParameterStatistics

MEAN_LIMIT = 0.25  # largest difference of means, in standard deviations of the paper
STD_RATIO = (0.75, 1.33)  # smallest and largest ratio of standard deviations
RANGE_LIMIT = 0.10  # how far a value may lie beyond the paper's range, as a share of its width
FULL_SIZE = 100_000  # frames from which the table has to hold; fewer are a rough sample of it
MODE_WIDTH = math.pi / 4  # distance from ±π, rad, within which a frame is of a mode of rotation_x
MODE_SHARE = 0.20  # least share of frames in each mode
BETWEEN_SHARE = 0.01  # largest share with |rotation_x| < π/2, where the probe would look up


@dataclass(frozen=True)
class Verdict:
    """One parameter beside the paper's row."""

    mean: float  # |mean - paper's|, in standard deviations of the paper
    std: float  # ratio of the standard deviations
    beyond: float  # how far the extremes lie outside the paper's range, as a share of its width

    @property
    def faults(self) -> list[str]:
        """What does not hold."""
        limits = (
            (self.mean <= MEAN_LIMIT, f"mean off by {self.mean:.2f} std"),
            (STD_RATIO[0] <= self.std <= STD_RATIO[1], f"std x {self.std:.2f}"),
            (self.beyond <= RANGE_LIMIT, f"{100 * self.beyond:.0f} % beyond the range"),
        )
        return [fault for holds, fault in limits if not holds]


def statistics_of(parameters: np.ndarray) -> dict[str, ParameterStatistics]:
    """Return the statistics of the columns of (N, 12) parameters that were measured at all."""
    statistics = {}
    for index, name in enumerate(PARAMETERS):
        values = parameters[:, index].astype(np.float64)
        values = values[~np.isnan(values)]
        if len(values):
            moments = values.min(), values.max(), values.mean(), values.std()
            statistics[name] = ParameterStatistics(*(float(moment) for moment in moments))
    return statistics


def verdicts_of(statistics: dict[str, ParameterStatistics]) -> dict[str, Verdict]:
    """Hold each parameter beside the paper's table."""
    verdicts = {}
    for name, ours in statistics.items():
        paper = PAPER_STATISTICS[name]
        outside = max(paper.minimum - ours.minimum, ours.maximum - paper.maximum, 0.0)
        verdicts[name] = Verdict(
            mean=abs(ours.mean - paper.mean) / paper.std,
            std=ours.std / paper.std,
            beyond=outside / (paper.maximum - paper.minimum),
        )
    return verdicts


def has_paper(manifest: dict[str, Any]) -> bool:
    """Return whether the paper's table is the measure of this dataset: the block with a heart."""
    return manifest["source"] == "release" or _simulates_heart(manifest)


def must_meet_paper(manifest: dict[str, Any]) -> bool:
    """Return whether a departure from the paper's table is a fault.

    It is for the simulated heart at full size, which is calibrated to the table. It is not for
    recordings: what was published is what it is, and an import may be of a part of it.
    """
    return _simulates_heart(manifest) and manifest["counts"]["frames"] >= FULL_SIZE


def _simulates_heart(manifest: dict[str, Any]) -> bool:
    if manifest["source"] != "phantom":
        return False
    node: Any = manifest.get("recipe") or {}
    for key in ("settings", "acquisition", "phantom"):
        node = node.get(key) or {}
    return node.get("anatomy", "heart") == "heart"


def check_paper(verdicts: dict[str, Verdict]) -> str:
    """Check that every parameter was measured and holds."""
    faults = [f"{name} was not measured" for name in PARAMETERS if name not in verdicts]
    faults += [
        f"{name}: {', '.join(verdict.faults)}"
        for name, verdict in verdicts.items()
        if verdict.faults
    ]
    if faults:
        held = len(PARAMETERS) - len(faults)
        raise RacinesError(f"{held} of 12 parameters hold; {'; '.join(faults)}")
    furthest = max(verdict.mean for verdict in verdicts.values())
    ratios = [verdict.std for verdict in verdicts.values()]
    return (
        f"12 of 12 parameters hold: means within {furthest:.2f} std, std ratios "
        f"{min(ratios):.2f} to {max(ratios):.2f}"
    )


def check_modes(parameters: np.ndarray) -> str:
    """Check that rotation_x has two modes, at ±π, and next to nothing between them.

    A probe that looks down has rotation_x = ±π, and hand and tremor carry it across the jump.
    """
    angle = parameters[:, PARAMETERS.index("rotation_x")]
    near = np.abs(np.abs(angle) - math.pi) <= MODE_WIDTH
    shares = near & (angle > 0), near & (angle < 0), np.abs(angle) < math.pi / 2
    up, down, between = (float(share.mean()) for share in shares)
    said = f"{100 * up:.1f} % within 45° of +π, {100 * down:.1f} % of -π"
    if min(up, down) < MODE_SHARE:
        raise RacinesError(f"{said}; each mode needs {100 * MODE_SHARE:.0f} %")
    if between > BETWEEN_SHARE:
        raise RacinesError(f"{said}, and {100 * between:.1f} % look upwards")
    return f"{said}, {100 * between:.1f} % between"
