"""The report on an imported set for people: frames with what they are called, and a few rows."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from racines_data.plotting import card_style, encode
from racines_models.sample import evenly
from racines_models.studies.sim_to_real.imported import Imported

ROWS, COLUMNS = 3, 8


def sheet(measured: Imported) -> bytes:
    """Return a PNG of frames at even distances, each under what the grader calls it."""
    with card_style():
        return encode(_figure(measured), gray=True)


def _figure(measured: Imported) -> Figure:
    figure = Figure((1.35 * COLUMNS, 1.65 * ROWS), layout="constrained")
    axes = figure.subplots(ROWS, COLUMNS).ravel()
    shown = evenly(len(measured.images), ROWS * COLUMNS).tolist()
    for axis in axes:
        axis.axis("off")
    for axis, row in zip(axes, shown, strict=False):
        axis.imshow(measured.images[row].numpy(), cmap="gray", vmin=0, vmax=255)
        axis.set_title(measured.called[row] if measured.called else "", fontsize=8, pad=2)
    of = f"{len(shown)} of {len(measured.images)} frames"
    figure.suptitle(f"called so by a grader of simulated patients; {of}", fontsize=9)
    return figure


def told_rows(content: dict[str, Any]) -> list[tuple[str, str]]:
    """Return what was measured as rows of a table."""
    rows = [("frames, trajectories", f"{content['frames']}, {content['trajectories']}")]
    recognised = content.get("recognised", {})
    for name, figure in recognised.get("views", {}).items():
        rows.append((f"{name} called {name}", f"{figure['value']:.0%} (n = {figure['n']})"))
    for name, count in recognised.get("called", {}).items():
        rows.append((f"called {name}", f"{count / max(1, content['frames']):.0%}"))
    kid = content.get("kid", {}).get("value")
    if kid is not None:
        rows.append(("KID to simulated A4C", f"{kid:.3f} (n = {content['kid']['n']})"))
    for name, unit in (("angle_deg", "°"), ("shift_mm", " mm")):
        found = content.get("motion", {}).get(name)
        if found:
            r = found["correlation"]
            told = f"median {found['error_median']:.1f}{unit} of {found['true_median']:.1f}{unit}"
            shown = "-" if r is None or np.isnan(r) else f"{r:.2f}"
            rows.append((f"motion read, {name.split('_')[0]}", f"{told} off, r = {shown}"))
    return rows
