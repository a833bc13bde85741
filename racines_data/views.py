"""The standard views, and the paper's statistics of the twelve parameters."""

from collections.abc import Sequence
from dataclasses import dataclass

from racines_data.errors import RacinesError
from racines_data.plugins import Plugins

VIEWS = ("A4C", "SC", "PL", "PSAV", "PSMV")
"""The five target views; the index of a view here is its label."""

RANDOM = "Random"
LABELS = (*VIEWS, RANDOM)
"""Class labels of a frame, in label order: the five views, then `Random`."""
RANDOM_LABEL = len(VIEWS)

VIEW_TITLES = {
    "A4C": "apical four-chamber",
    "SC": "subcostal four-chamber",
    "PL": "parasternal long axis",
    "PSAV": "parasternal short axis, aortic valve",
    "PSMV": "parasternal short axis, mitral valve",
    "Random": "no standard view",
}
MIDDLES = {
    "A4C": (0.407, -0.034, 0.059, -2.50, 0.37, -1.46),
    "SC": (0.424, 0.071, 0.059, -2.54, -0.33, -1.89),
    "PL": (0.518, 0.026, 0.059, -3.04, 0.30, 0.65),
    "PSAV": (0.573, 0.075, 0.059, 2.47, 0.03, -0.85),
    "PSMV": (0.547, 0.064, 0.059, 2.46, 0.03, -0.85),
}
"""Where a view lies whoever is scanned: position, m, and extrinsic xyz angles, rad, base frame.
Means over the train patients 1-120, rounded, written down once: they are part of the tasks' rules
and need not follow when patients change a little. The patients' own nominal poses lie 30 mm and 13°
from there (medians)."""
HEART = "heart"  # the anatomy that everything takes where none is named
ANATOMIES = Plugins("anatomy", "racines.anatomies", or_give="module:function")
"""Functions `(seed: int) -> Anatomy`. The extras of an entry point name its views in label order,
so that they are known without importing it: `abdomen = "module:function [KLX,KSX,GB]"`."""


def organs() -> dict[str, tuple[str, ...]]:
    """Return the views of the registered anatomies, the heart first; nothing is imported."""
    named = {name: tuple(point.extras) for name, point in ANATOMIES.points().items()}
    return {HEART: VIEWS} | {name: views for name, views in named.items() if views}


def labels_of(views: Sequence[str]) -> tuple[str, ...]:
    """Return the class labels of an anatomy's views, in label order: the views, then `Random`."""
    return (*views, RANDOM)


def check_labels(labels: Sequence[str], where: str) -> tuple[str, ...]:
    """Return labels that can be names of files, as they are in cards and exports.

    Raises:
        RacinesError: one has a slash or a sign that cannot be seen, or stands for a folder.
    """
    for label in labels:
        if not label.isprintable() or {"/", "\\"} & {*label} or label.strip(". ") == "":
            raise RacinesError(
                f"{where}: {label!r} is no name of a view: files are named by it, so give one "
                "without slashes and control characters"
            )
    return tuple(labels)


@dataclass(frozen=True)
class ParameterStatistics:
    """Minimum, maximum, mean and standard deviation of one parameter."""

    minimum: float
    maximum: float
    mean: float
    std: float


PAPER_STATISTICS = {
    "force_x": ParameterStatistics(-26.8882, 28.4758, -0.0600, 6.3660),
    "force_y": ParameterStatistics(-42.6100, 28.7321, -1.5118, 6.4483),
    "force_z": ParameterStatistics(-19.9065, 17.9240, -9.4422, 4.5702),
    "torque_x": ParameterStatistics(-7.2058, 8.1759, -0.2110, 1.3068),
    "torque_y": ParameterStatistics(-4.9334, 6.6932, 0.1395, 1.0109),
    "torque_z": ParameterStatistics(-0.8552, 0.8573, 0.0650, 0.4330),
    "position_x": ParameterStatistics(0.3999, 0.5833, 0.4886, 0.0375),
    "position_y": ParameterStatistics(-0.0744, 0.0801, 0.0380, 0.0216),
    "position_z": ParameterStatistics(0.0400, 0.1339, 0.0602, 0.0115),
    "rotation_x": ParameterStatistics(-3.1416, 3.1416, 0.0399, 2.9759),
    "rotation_y": ParameterStatistics(-0.7959, 0.6613, 0.0412, 0.2355),
    "rotation_z": ParameterStatistics(-2.1800, 2.1534, 0.0317, 1.0826),
}
"""Table 1 of the paper, over 144,668 frames; N, N·m, m (headed "mm" there) and rad."""
