"""The picture of a robustness study: what each disturbance costs, at three strengths."""

from typing import Any

from matplotlib.figure import Figure

from racines_data.escape import visible
from racines_data.plotting import MUTED, STRENGTH_COLOURS, card_style, encode
from racines_envs.studies.robustness.disturbances import DISTURBANCES, STRENGTHS
from racines_envs.studies.robustness.run import NOTHING, RANKED, changes
from racines_models.statistics import LEVEL

APART = 0.22
"""Between the strengths of a disturbance, as a share of its line."""


@card_style()
def draw_robustness(document: dict[str, Any]) -> bytes:
    """Return a PNG: a line a disturbance, the costliest at the top; dots with their intervals."""
    rows = list(changes(document))
    base = document["conditions"][NOTHING]["metrics"][RANKED]
    canvas = Figure(figsize=(7.2, 1.3 + 0.42 * len(rows)), layout="constrained")
    axis = canvas.subplots()
    axis.axvline(0.0, color=MUTED, linewidth=0.9)
    for line, (_, found) in enumerate(rows):
        for level, change in enumerate(found):
            if change is None:
                continue
            height = line + APART * (level - 1)
            ends = [100 * change[key] for key in ("low", "high") if change[key] is not None]
            axis.plot(
                ends, [height] * len(ends), color=STRENGTH_COLOURS[level], linewidth=2.4, alpha=0.6
            )
            label = STRENGTHS[level] if line == 0 else None
            axis.plot(
                100 * change["value"], height, "o", color=STRENGTH_COLOURS[level], label=label
            )
    axis.set_yticks(range(len(rows)), [_title(name) for name, _ in rows])
    axis.set_ylim(len(rows) - 0.4, -0.6)
    axis.set_xlabel("change of the share found and declared, percentage points")
    units, n = base["settings"]["units"], base["n"]
    title = f"{visible(document['agent'])} on {document['task']['view']}: {100 * base['value']:.0f}"
    canvas.suptitle(f"{title} % with nothing wrong ({units} patients, n = {n})", size=10.5)
    axis.grid(visible=False, axis="y")
    axis.spines["left"].set_visible(False)
    told = f"Lines: {100 * LEVEL:g} % intervals of the paired change. Strength:"
    canvas.legend(loc="outside lower center", ncols=len(STRENGTHS), title=told)
    return encode(canvas, dpi=150)


def _title(name: str) -> str:
    """Return a disturbance with its strengths, as `haze: 4, 8, 12 dB`."""
    if name not in DISTURBANCES:
        return "all at once"
    each = DISTURBANCES[name]
    return f"{name}: {', '.join(f'{amount:g}' for amount in each.amounts)} {each.unit}"
