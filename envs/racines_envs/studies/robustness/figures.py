"""The picture of a robustness study: what each disturbance costs, at three strengths."""

import io
from typing import Any

from matplotlib.figure import Figure

from racines_data.escape import visible
from racines_envs.studies.robustness.disturbances import DISTURBANCES, STRENGTHS
from racines_envs.studies.robustness.run import NOTHING, RANKED, changes

INKS = ("#9db7d5", "#4f7fb5", "#1f3a5f")
"""Mild, moderate, strong."""
APART = 0.22
"""Between the strengths of a disturbance, as a share of its line."""


def draw_robustness(document: dict[str, Any]) -> bytes:
    """Return a PNG: a line a disturbance, the costliest at the top; dots with their intervals."""
    rows = list(changes(document))
    base = document["conditions"][NOTHING]["metrics"][RANKED]
    canvas = Figure(figsize=(7.2, 1.3 + 0.42 * len(rows)), layout="constrained")
    axis = canvas.subplots()
    axis.axvline(0.0, color="#888888", linewidth=0.9)
    for line, (_, found) in enumerate(rows):
        for level, change in enumerate(found):
            if change is None:
                continue
            height = line + APART * (level - 1)
            ends = [100 * change[key] for key in ("low", "high") if change[key] is not None]
            axis.plot(ends, [height] * len(ends), color=INKS[level], linewidth=2.4, alpha=0.6)
            label = STRENGTHS[level] if line == 0 else None
            axis.plot(100 * change["value"], height, "o", color=INKS[level], label=label)
    axis.set_yticks(range(len(rows)), [_title(name) for name, _ in rows], size=9)
    axis.set_ylim(len(rows) - 0.4, -0.6)
    axis.set_xlabel("change of the share found and declared, percentage points", size=9)
    units, n = base["settings"]["units"], base["n"]
    title = f"{visible(document['agent'])} on {document['task']['view']}: {100 * base['value']:.0f}"
    canvas.suptitle(f"{title} % with nothing wrong ({units} patients, n = {n})", size=10)
    axis.grid(axis="x", color="#dddddd", linewidth=0.7)
    axis.set_axisbelow(True)
    axis.spines[["top", "right", "left"]].set_visible(False)
    canvas.legend(fontsize=8, frameon=False, loc="outside lower center", ncols=len(STRENGTHS))
    image = io.BytesIO()
    canvas.savefig(image, format="png", dpi=140)
    return image.getvalue()


def _title(name: str) -> str:
    """Return a disturbance with its strengths, as `haze: 4, 8, 12 dB`."""
    if name not in DISTURBANCES:
        return "all at once"
    each = DISTURBANCES[name]
    return f"{name}: {', '.join(f'{amount:g}' for amount in each.amounts)} {each.unit}"
