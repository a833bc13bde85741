"""The picture of an ablation: one bar a variant, the full phantom as a line."""

from typing import Any

from matplotlib.figure import Figure

from racines_data.card_style import MUTED, OURS, PAPER, card_style, encode


def draw_ablation(content: dict[str, Any]) -> bytes:
    """Return a PNG of the KID of each variant with its range over the halves of the real set."""
    rows, base = content["ablation"][::-1], content["base"]
    with card_style():
        figure = Figure(figsize=(7.2, 1.4 + 0.27 * len(rows)), layout="constrained")
        axes = figure.add_subplot()
        kid = [row["kid"] for row in rows]
        reach = [[r["kid"] - r["low"] for r in rows], [r["high"] - r["kid"] for r in rows]]
        colours = [OURS if row["change"] > 0 else MUTED for row in rows]
        names = [row["name"] for row in rows]
        axes.barh(names, kid, 0.66, xerr=reach, color=colours, error_kw={"elinewidth": 0.8})
        for i, row in enumerate(rows):
            axes.annotate(f" {row['change']:+.3f}", (row["high"], i), va="center", fontsize=7.5)
        axes.axvspan(base["low"], base["high"], color=PAPER, alpha=0.12, linewidth=0)
        axes.axvline(base["kid"], color=PAPER, linewidth=1.2)
        axes.annotate(
            f"full phantom {base['kid']:.3f}",
            (base["kid"], len(rows) - 0.4),
            color=PAPER,
            ha="center",
            va="bottom",
        )
        axes.grid(visible=False, axis="y")
        axes.margins(x=0.09)
        axes.set_xlabel(
            f"KID to real {content['view']} frames, n = {content['n']}; lower is nearer"
        )
        return encode(figure)
