"""A moment of an episode as HTML: the image, gauges, curves and the probe over the block."""

import io
from collections.abc import Callable, Sequence

import numpy as np
from PIL import Image

from racines_leaderboard.studio.escape import text
from racines_leaderboard.studio.pictures import element
from racines_leaderboard.studio.scene import Curve, Scene

COLOURS = {"grader": "#38bdf8", "truth": "#facc15"}
WIDE, HIGH = 360, 118
"""Of a drawing, in its own units; it is drawn as wide as its place."""
LEFT, RIGHT, TOP, BOTTOM = 30, 350, 24, 98
FULL_FORCE = 1.25
"""Right end of the force gauge, in force limits."""
AXES = ("x", "y", "z")

CSS = """
.rs-state { display: flex; flex-wrap: wrap; gap: .25rem .9rem; margin: .45rem 0; font-size: .95rem;
  font-variant-numeric: tabular-nums; }
.rs-state b { font-weight: 600; }
.rs-draw { display: block; width: 100%; height: auto; background: #1a2026; border-radius: 6px;
  margin-bottom: .5rem; }
.rs-draw text { font: 11px system-ui, sans-serif; fill: #e6e9ec; }
.rs-block { display: grid; gap: .5rem;
  grid-template-columns: repeat(auto-fit, minmax(220px, 1fr)); }
.rs-block img { width: 100%; height: auto; border-radius: 6px; display: block; }
.rs-scan { background: #000; border-radius: 6px; }
.rs-scan img { width: 100%; max-width: 440px; display: block; margin: 0 auto; }
.rs-wrench { font-size: .86rem; color: var(--body-text-color-subdued); margin: 0 0 .5rem;
  font-variant-numeric: tabular-nums; }
"""


def image_panel(scene: Scene, image: np.ndarray | None = None) -> str:
    """Return the ultrasound image and the state in words; `image` in place of the scene's."""
    shown = scene.image if image is None else image
    alt = f"{scene.task}, step {scene.step}: ultrasound image"
    scan = element(quick_png(Image.fromarray(shown)), alt, "")
    return f'<div class="rs-scan">{scan}</div>{state_line(scene)}{_ending(scene)}'


def quick_png(image: Image.Image) -> bytes:
    """Return a picture as PNG, packed lightly: a step must not wait for its smallest file."""
    buffer = io.BytesIO()
    image.save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()


def _sketch(image: Image.Image) -> bytes:
    """Return a drawing of few colours as PNG."""
    return quick_png(image.quantize(48, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE))


def state_line(scene: Scene) -> str:
    """Return step, refusals, judgement and, where it is shown, the truth."""
    workspace, force = scene.refused
    parts = [
        f"<b>{text(scene.task)}</b>",
        f"step <b>{scene.step}</b> of {scene.most}",
        f"last: <b>{text(scene.action)}</b>",
        f"refused: <b>{workspace}</b> at the workspace, <b>{force}</b> by force",
    ]
    parts += [
        f"{text(curve.name)}: p <b>{curve.probabilities[scene.step]:.2f}</b>, "
        f"grade <b>{curve.grades[scene.step]:.1f}</b>"
        for curve in scene.curves
    ]
    if scene.truth is not None:
        truth = scene.truth
        parts.append(f"true view <b>{text(truth.view)}</b>, grade <b>{truth.grade:.1f}</b>")
        parts.append(
            f"to the nominal pose <b>{truth.millimetres:.0f} mm</b>, <b>{truth.degrees:.0f}°</b>"
        )
    return f'<div class="rs-state">{"".join(f"<span>{part}</span>" for part in parts)}</div>'


def side_panel(scene: Scene) -> str:
    """Return force gauge, curves and the probe over the block."""
    views = (("from above", scene.above), ("from the front", scene.front))
    pictures = [element(_sketch(view), f"probe {name}", "") for name, view in views]
    needed_p, needed_grade = scene.needed
    return (
        force_gauge(scene)
        + _chart(f"grade as {scene.view}", scene, 10.0, needed_grade)
        + _chart(f"probability of {scene.view}", scene, 1.0, needed_p)
        + f'<div class="rs-block">{"".join(pictures)}</div>'
    )


def force_gauge(scene: Scene) -> str:
    """Return the normal force as a bar with its limit and its peak, and the wrench in numbers."""
    full = FULL_FORCE * scene.limit

    def at(force: float) -> float:
        return LEFT + (RIGHT - LEFT) * min(max(force / full, 0.0), 1.0)

    high = scene.force > 0.9 * scene.limit
    limit, peak = at(scene.limit), at(scene.peak)
    drawn = [
        _words(LEFT, 16, f"normal force {scene.force:.1f} N"),
        _words(RIGHT, 16, f"peak {scene.peak:.1f} N, limit {scene.limit:.0f} N", "end"),
        f'<rect x="{LEFT}" y="24" width="{RIGHT - LEFT}" height="16" fill="#2f3942"/>',
        f'<rect x="{LEFT}" y="24" width="{at(scene.force) - LEFT:.1f}" height="16" '
        f'fill="{"#f87171" if high else "#4ade80"}"/>',
        f'<line x1="{peak:.1f}" x2="{peak:.1f}" y1="22" y2="42" stroke="#e6e9ec"/>',
        f'<line x1="{limit:.1f}" x2="{limit:.1f}" y1="20" y2="44" stroke="#f87171" '
        'stroke-width="2.5"/>',
    ]
    force = ", ".join(f"{a} {v:+.1f}" for a, v in zip(AXES, scene.wrench[:3], strict=True))
    torque = ", ".join(f"{a} {v:+.2f}" for a, v in zip(AXES, scene.wrench[3:], strict=True))
    numbers = f'<p class="rs-wrench">force {force} N · torque {torque} N·m</p>'
    return _svg(drawn, 50, f"normal force {scene.force:.1f} N") + numbers


def _chart(title: str, scene: Scene, full: float, needed: float) -> str:
    """Return one quantity of all curves over the steps, with what a hit needs."""
    steps = max(20, *(len(curve.grades) - 1 for curve in scene.curves), 0)

    def at(step: float, share: float) -> tuple[float, float]:
        share = min(max(share, 0.0), 1.0)
        return LEFT + (RIGHT - LEFT) * step / steps, BOTTOM - (BOTTOM - TOP) * share

    level = at(0, needed / full)[1]
    drawn = [_words(LEFT, 15, title)]
    for share in (0.0, 0.5, 1.0):
        y = at(0, share)[1]
        drawn.append(f'<line x1="{LEFT}" x2="{RIGHT}" y1="{y}" y2="{y}" stroke="#2f3942"/>')
        drawn.append(_words(LEFT - 5, y + 4, f"{share * full:g}", "end"))
        x, anchor = at(share * steps, 0)[0], ("start", "middle", "end")[int(2 * share)]
        drawn.append(_words(x, BOTTOM + 14, f"{share * steps:.0f}", anchor))
    drawn.append(
        f'<line x1="{LEFT}" x2="{RIGHT}" y1="{level:.1f}" y2="{level:.1f}" stroke="#7d8a96" '
        'stroke-dasharray="4 4"/>'
    )
    for place, curve in enumerate(scene.curves):
        colour = COLOURS.get(curve.name, "#e6e9ec")
        drawn.append(_words(RIGHT - 60 * place, 15, curve.name, "end", colour))
        drawn.append(_line(curve, full, at, scene.step, colour))
    if not scene.curves:
        drawn.append(_words((LEFT + RIGHT) / 2, 64, "no grader here: show the truth", "middle"))
    drawn.append(_words((LEFT + RIGHT) / 4 * 3, BOTTOM + 14, "steps", "middle"))
    return _svg(drawn, HIGH, f"{title} over the steps")


def _line(
    curve: Curve,
    full: float,
    at: Callable[[float, float], tuple[float, float]],
    step: int,
    colour: str,
) -> str:
    values: Sequence[float] = curve.grades if full > 1 else curve.probabilities
    points = [at(i, value / full) for i, value in enumerate(values)]
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    x, y = points[step]
    return (
        f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="2"/>'
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="{colour}"/>'
    )


def _words(x: float, y: float, words: str, anchor: str = "start", colour: str = "") -> str:
    fill = f' style="fill:{colour}"' if colour else ""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{fill}>{text(words)}</text>'


def _svg(drawn: Sequence[str], height: int, alt: str) -> str:
    box = f'viewBox="0 0 {WIDE} {height}" role="img" aria-label="{text(alt)}"'
    return f'<svg class="rs-draw" {box}>{"".join(drawn)}</svg>'


def _ending(scene: Scene) -> str:
    if not scene.ended:
        return ""
    mark = "rc-done" if scene.success else "rc-refused"
    return f'<p class="{mark}">The episode is over: {text(scene.ended)}.</p>'
