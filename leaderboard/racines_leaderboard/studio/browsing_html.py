"""What the dataset's page shows of a frame: image, labels, parameters, and where it lies."""

import math

from racines_data.schema import PARAMETERS
from racines_leaderboard.studio.browsing import Sweep
from racines_leaderboard.studio.escape import text
from racines_leaderboard.studio.pictures import Drawings, element, image_png, ultrasound
from racines_leaderboard.studio.sweep_figures import Marked, grades_figure, path_figure

UNITS = {"force": "N", "torque": "N·m", "position": "mm", "rotation": "°"}
SCALES = {"position": 1e3, "rotation": 180.0 / math.pi}
"""From the data's SI units to those that are shown."""


def image_html(sweep: Sweep, frame: int) -> str:
    """Return a frame's image on black, with its view and grade below."""
    row = sweep.first + frame
    store = sweep.store
    label, grade = int(store.views[row]), float(store.grades[row])
    view = store.labels[label] if label >= 0 else "view unknown"
    graded = f"grade {grade:.1f}" if math.isfinite(grade) else "no grade"
    seconds = f", {sweep.times[frame]:.2f} s" if sweep.timed else ""
    told = f"{view}, {graded} · frame {frame + 1} of {sweep.frames}{seconds}"
    source = store.manifest["source"]
    simulated = "simulated" if source == "phantom" else f"source: {source}"
    picture = ultrasound(image_png(store.images[row].numpy()), told)
    return f'{picture}<p class="rc-note">{text(told)} · {text(simulated)}</p>'


def facts_html(sweep: Sweep) -> str:
    """Return what a trajectory is."""
    seconds = f", {sweep.times[-1]:.1f} s" if sweep.timed else ""
    manifest = sweep.store.manifest
    told = (
        f"{sweep.name}: {sweep.split} split, aimed at {sweep.target_view}, session "
        f"{sweep.session}, {sweep.frames} frames{seconds}. Data: {manifest['source']} "
        f"{manifest['version']}, digest {manifest['digest'][:12]}."
    )
    return f'<p class="rc-note">{text(told)}</p>'


def parameters_html(sweep: Sweep, frame: int) -> str:
    """Return the twelve parameters of a frame as a table."""
    values = sweep.store.parameters[sweep.first + frame].tolist()
    named: dict[str, float] = dict(zip(PARAMETERS, values, strict=True))
    rows = []
    for kind, unit in UNITS.items():
        scale = SCALES.get(kind, 1.0)
        cells = "".join(f"<td>{_number(scale * named[f'{kind}_{axis}'])}</td>" for axis in "xyz")
        rows.append(f'<tr><td class="rc-text">{kind}, {unit}</td>{cells}</tr>')
    head = "<th></th><th>x</th><th>y</th><th>z</th>"
    return (
        f'<div class="rc-scroll"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def figures_html(sweep: Sweep, frame: int) -> str:
    """Return the grade over time and the path in 3-D, with a mark at the frame."""
    grades, path = _figures(sweep)
    left = f"{100 * grades.places[frame, 0]:.2f}%"
    cursor = f'<div class="rc-cursor" style="left:{left};top:15%;height:63%"></div>'
    parts = [f'<div class="rc-over">{element(grades.png, "grade over time")}{cursor}</div>']
    if path is not None:
        x, y = 100 * path.places[frame]
        dot = f'<div class="rc-dot" style="left:{x:.2f}%;top:{y:.2f}%"></div>'
        parts.append(f'<div class="rc-over">{element(path.png, "path of the probe")}{dot}</div>')
    return "".join(parts)


_drawings: Drawings[tuple[Marked, Marked | None]] = Drawings(64)


def _figures(sweep: Sweep) -> tuple[Marked, Marked | None]:
    return _drawings.get(sweep, lambda: (grades_figure(sweep), path_figure(sweep)))


def _number(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "–"
