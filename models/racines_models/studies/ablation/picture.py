"""The picture of an ablation: one bar a variant, the full phantom as a line."""

from typing import Any

from matplotlib.figure import Figure

from racines_data.plotting import MUTED, OURS, PAPER, card_style, encode


def draw_ablation(content: dict[str, Any]) -> bytes:
    """Return a PNG of the KID of each variant, with the range of its change over the halves."""
    rows, base = content["ablation"][::-1], content["base"]
    with card_style():
        figure = Figure(figsize=(7.2, 1.4 + 0.27 * len(rows)), layout="constrained")
        axes = figure.add_subplot()
        kid = [row["kid"] for row in rows]
        below = [row["change"] - row["change_low"] for row in rows]
        above = [row["change_high"] - row["change"] for row in rows]
        colours = [OURS if row["change"] > 0 else MUTED for row in rows]
        names = [row["name"] for row in rows]
        axes.barh(
            names, kid, 0.66, xerr=[below, above], color=colours, error_kw={"elinewidth": 0.8}
        )
        for i, row in enumerate(rows):
            axes.annotate(
                f" {row['change']:+.3f}", (row["kid"] + above[i], i), va="center", fontsize=7.5
            )
        axes.axvline(base["kid"], color=PAPER, linewidth=1.2)
        axes.set_title(f"full phantom {base['kid']:.3f}", color=PAPER)
        axes.grid(visible=False, axis="y")
        axes.margins(x=0.09)
        axes.set_xlabel(
            f"KID to real {content['view']} frames, n = {content['n']}; lower is nearer"
        )
        return encode(figure)
