"""The picture and the tables of a study of what servos learn from generators' images."""

from collections.abc import Iterator, Sequence
from typing import Any, Literal

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from racines_data.escape import visible
from racines_data.plotting import BLUE, GREEN, MUTED, ORANGE, PURPLE, card_style, encode
from racines_data.tables import markdown_table
from racines_envs.studies.downstream.correlation import BOARD, OUTCOMES, PRIMARY, SCORE
from racines_models.statistics import LEVEL

NOTE = (
    f"{100 * LEVEL:g} % intervals: of a share, over the patients judged on; of ρ, over these and "
    "the train patients. The points, and each servo's training, are taken as they are: others may "
    "rank otherwise."
)
SIGNS = {
    "truth": (BLUE, "o"), "adapts": (GREEN, "D"), "ignores the patient": (ORANGE, "s"),
    "floor": (PURPLE, "^"),
}  # fmt: skip
"""Colour and marker of each kind of point."""
SCORES = {SCORE: "score: 0 the scouts' mean, 1 the truth", BOARD: "score by the board's anchors"}
"""What the scores are called."""
PANELS = {
    "ssim": "SSIM", "psnr": "PSNR, dB", "kid": "KID", "fid": "FID",
    "pose_error_mm": "pose error, mm", "dice": "Dice",
}  # fmt: skip
"""The metrics that have a panel of their own, and what they are called."""
NAMES = SCORES | PANELS | {"ms_ssim": "MS-SSIM", "pose_error_deg": "pose error, °"}
"""What every metric is called."""
COLUMNS = {
    SCORE: ("score", ".2f"), BOARD: ("score, the board's", ".2f"),
    "ssim": ("SSIM", ".3f"), "psnr": ("PSNR, dB", ".1f"),
    "kid": ("KID", ".3f"), "pose_error_mm": ("pose error, mm", ".0f"), "dice": ("Dice", ".2f"),
}  # fmt: skip
"""Metrics of the tables: what they are called, and how they are written."""
NARROW = (SCORE, "ssim", "kid", "dice")
"""Those that a terminal has room for."""
NAMED: list[tuple[tuple[float, float], Literal["left", "right"]]] = [
    ((side * across, up), "left" if side > 0 else "right")
    for across, up in ((6, 0), (5, 7), (5, -7), (12, 14), (12, -14), (20, 22), (20, -22), (34, 30))
    for side in (1, -1)
]
"""Where a point's name may stand, in typographic points off it, and its anchor; nearest first."""


@card_style()
def draw_downstream(document: dict[str, Any]) -> bytes:
    """Return a PNG: success of the servos against the score, and against each metric."""
    rows = document["points"]
    canvas = Figure(figsize=(10.2, 5.6), layout="constrained")
    names = list(PANELS)
    mosaic: Any = [[SCORE, *names[line : line + 2]] for line in range(0, len(names), 2)]
    axes = canvas.subplot_mosaic(mosaic, sharey=True, width_ratios=(2.0, 1.0, 1.0))
    first = axes[SCORE]
    scored = [row for row in rows if SCORE in row["metrics"]]
    _panel(first, document, scored, SCORE)
    first.set_xlabel(SCORES[SCORE])
    first.set_ylabel("found and declared by the servo, %")
    first.margins(x=0.16)
    for metric, title in PANELS.items():
        _panel(axes[metric], document, rows, metric)
        axes[metric].set_xlabel(title)
    seen = {row["kind"] for row in rows}
    drawn = [
        first.plot([], [], sign, color=colour, linestyle="", label=kind)[0]
        for kind, (colour, sign) in SIGNS.items()
        if kind in seen
    ]
    canvas.legend(handles=drawn, loc="outside lower center", ncols=len(drawn))
    settings = document["settings"]
    canvas.suptitle(
        f"What a servo learns from images of {settings['patients']} train patients, on "
        f"{settings['judged']} {settings['split']} patients (n = {len(rows)} points)",
        size=10.5,
    )
    _name_points(first, scored)
    return encode(canvas, dpi=150)


def _name_points(axis: Axes, rows: Sequence[dict[str, Any]]) -> None:
    """Write each point's name beside it, where it meets no other point or name."""
    canvas = axis.get_figure(root=True)
    assert isinstance(canvas, Figure)
    canvas.draw_without_rendering()  # places are known after the layout
    places = [(row["metrics"][SCORE]["value"], _percent(row)) for row in rows]
    points = axis.transData.transform(places)
    taken = [Bbox.from_bounds(x - 4, y - 4, 8, 8) for x, y in points]
    for row, at in zip(rows, places, strict=True):
        for offset, side in NAMED:
            name = axis.annotate(
                visible(row["label"]), at, offset, textcoords="offset points", size=6.5,
                ha=side, va="center", arrowprops={"arrowstyle": "-", "lw": 0.4, "color": MUTED},
            )  # fmt: skip
            name.get_window_extent()  # places it
            box = Text.get_window_extent(name).padded(0.5)  # without the line to its point
            inside = all(axis.bbox.contains(*corner) for corner in (box.p0, box.p1))
            if inside and not any(box.overlaps(other) for other in taken):
                break
            name.remove()
        else:
            continue  # a crowd: the table names it
        taken.append(box)


def _panel(axis: Axes, document: dict[str, Any], rows: Sequence[dict[str, Any]], key: str) -> None:
    """Draw all points' success against a metric, and tell the rank correlation."""
    for row in rows:
        colour, sign = SIGNS[row["kind"]]
        told, height = row["outcome"][PRIMARY[1]], _percent(row)
        ends = [100 * told[end] for end in ("low", "high") if told[end] is not None]
        x = row["metrics"][key]["value"]
        axis.plot([x] * len(ends), ends, color=colour, linewidth=0.8, alpha=0.45)
        axis.plot(x, height, sign, color=colour, markersize=4.5)
    found = correlation(document, key)
    if found is not None and found["spearman"]["value"] is not None:
        rho = found["spearman"]
        axis.set_title(
            f"ρ = {rho['value']:.2f} ({rho['low']:.2f} to {rho['high']:.2f})", size=8.5, loc="left",
            color=MUTED,
        )  # fmt: skip


def _percent(row: dict[str, Any]) -> float:
    return 100 * row["outcome"][PRIMARY[1]]["value"]


def correlation(
    document: dict[str, Any], metric: str, outcome: str = PRIMARY[1], points: str = "all points"
) -> dict[str, Any] | None:
    """Return what a document tells of a metric and an outcome; None where it does not."""
    asked = {"metric": metric, "outcome": outcome, "points": points}
    return next((row for row in document["correlations"] if asked.items() <= row.items()), None)


def heads(columns: Sequence[str] = tuple(COLUMNS)) -> tuple[str, ...]:
    """Return the titles of `point_rows`."""
    return ("point", *(COLUMNS[name][0] for name in columns), "found and declared", "grade")


def point_rows(
    document: dict[str, Any], columns: Sequence[str] = tuple(COLUMNS)
) -> Iterator[tuple[str, ...]]:
    """Yield a line of `heads` of each point, those with the best servos first."""
    for row in sorted(document["points"], key=_percent, reverse=True):
        metrics, outcome = row["metrics"], row["outcome"]
        told = [
            format(metrics[name]["value"], COLUMNS[name][1]) if name in metrics else "–"
            for name in columns
        ]
        grade = outcome["final_grade"]["value"]
        yield (row["label"], *told, _share(outcome[PRIMARY[1]]), f"{grade:.1f}")


def correlation_rows(document: dict[str, Any], outcome: str) -> Iterator[tuple[str, ...]]:
    """Yield a metric and its ρ with an outcome in each group of points."""
    groups = list(dict.fromkeys(row["points"] for row in document["correlations"]))
    for metric in dict.fromkeys(row["metric"] for row in document["correlations"]):
        told = [correlation(document, metric, outcome, each) for each in groups]
        yield NAMES[metric], *(_told(each) for each in told)


def groups_of(document: dict[str, Any]) -> list[str]:
    """Return a title of each group of points, with how many they are."""
    counts = {row["points"]: row["n"] for row in document["correlations"]}
    return [f"{name} ({count})" for name, count in counts.items()]


def _told(row: dict[str, Any] | None) -> str:
    if row is None or row["spearman"]["value"] is None:
        return "–"
    return "{value:.2f} ({low:.2f} to {high:.2f})".format(**row["spearman"])


def _share(figure: dict[str, Any]) -> str:
    value, low, high = (figure[key] for key in ("value", "low", "high"))
    ends = "" if low is None else f" ({100 * low:.0f}–{100 * high:.0f})"
    return f"{100 * value:.0f} %{ends}"


def page(document: dict[str, Any]) -> str:
    """Return the tables as Markdown."""
    parts = [markdown_table(heads(), point_rows(document), right=1)]
    titles = ("metric", *groups_of(document))
    for outcome in OUTCOMES if document["correlations"] else ():
        rows = list(correlation_rows(document, outcome))
        parts += [f"Spearman's ρ with `{outcome}`:", markdown_table(titles, rows, right=1)]
    return "\n\n".join([*parts, document["note"]]) + "\n"
