"""One moment of an episode: what a page shows of it, taken from a core, and how, as HTML."""

import copy
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image

from racines_leaderboard.studio.html import text
from racines_leaderboard.studio.pictures import element

ZOOM = 2
"""Of the views of the block: twice a screen's pixels, so that their text stays sharp."""


@dataclass(frozen=True)
class Curve:
    """Whose judgement of the images, step by step from the start on."""

    name: str
    probabilities: Sequence[float]
    """Of the target view."""
    grades: Sequence[float]
    """As the target view, 0-10."""


@dataclass(frozen=True)
class Truth:
    """What the phantom knows and an agent is not told."""

    view: str
    grade: float
    millimetres: float
    """To the nominal pose."""
    degrees: float
    out_of_support: bool


@dataclass(frozen=True)
class Scene:
    """One moment of an episode."""

    task: str
    view: str
    step: int
    most: int
    """Steps after which the episode is over."""
    action: str
    """The last one, or `start`."""
    image: np.ndarray
    """(128, 128) uint8."""
    above: Image.Image
    front: Image.Image
    force: float
    """Normal force, N; with its limit and its peak so far."""
    limit: float
    peak: float
    wrench: tuple[float, ...]
    """Force, N, and torque, N·m, in the probe's axes."""
    refused: tuple[int, int]
    """Steps that were refused at the workspace, and at the force limit."""
    curves: tuple[Curve, ...]
    needed: tuple[float, float]
    """p and grade of a hit."""
    ended: str
    """Why the episode is over; empty while it is not."""
    success: bool
    truth: Truth | None
    """None where it is hidden."""


@dataclass(frozen=True)
class Snapshot:
    """The only row of a core at one moment, to be drawn later."""

    state: Any
    info: dict[str, Any]
    """`ScanCore.info`, as numbers."""
    image: Any
    """(1, 128, 128) uint8 tensor."""


def snapshot(core: Any) -> Snapshot:
    """Return the present moment of a core of one row."""
    info = {name: value[0].item() for name, value in core.info(view_error=False).items()}
    return Snapshot(copy.copy(core.state), info, core.picture())


def take_scene(
    core: Any, moment: Snapshot, steps: Any, curves: Sequence[Curve], truth: bool
) -> Scene:
    """Return what a page shows of a moment of a core; `steps` are those so far."""
    from racines_envs.apis.rendering import block_views
    from racines_envs.task.actions import ACTIONS

    core, info = copy.copy(core), moment.info
    core.state = moment.state
    task, last = core.task, steps.actions[-1]
    above, front = block_views(core, 0, steps, truth, ZOOM)
    return Scene(
        task=task.id,
        view=task.view,
        step=int(info["steps"]),
        most=task.max_steps,
        action="start" if last is None else ACTIONS[last],
        image=moment.image[0].cpu().numpy(),
        above=above,
        front=front,
        force=info["force"],
        limit=task.force_limit,
        peak=info["peak_force"],
        wrench=tuple(core.state.wrench[0].tolist()),
        refused=(int(info["workspace_hits"]), int(info["force_hits"])),
        curves=tuple(curves),
        needed=(core.rewards.probability, core.rewards.grade),
        ended=_why(core, bool(info["success"])),
        success=bool(info["success"]),
        truth=_truth(core, info) if truth else None,
    )


def _why(core: Any, success: bool) -> str:
    if not bool(core.state.done[0]):
        return ""
    task = core.task
    if task.hits_to_end and int(core.state.streak[0]) >= task.hits_to_end:
        return f"{task.view} was held for {task.hits_to_end} steps in a row"
    shown = "the view is in sight" if success else "the view was not found"
    return f"all {task.max_steps} steps are taken, and {shown}"


def _truth(core: Any, info: dict[str, Any]) -> Truth:
    from racines_envs.apis.rendering import view_names

    return Truth(
        view=view_names(core)[int(info["view"])],
        grade=info["grade"],
        millimetres=1e3 * info["position_error"],
        degrees=math.degrees(info["rotation_error"]),
        out_of_support=bool(info.get("out_of_support", False)),
    )


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


def panels(scene: Scene) -> tuple[str, str]:
    """Return the two halves of a page: the image with its state, and what stands beside it."""
    return image_panel(scene), side_panel(scene)


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
    words = [
        f"<b>{text(scene.task)}</b>",
        f"step <b>{scene.step}</b> of {scene.most}",
        f"last: <b>{text(scene.action)}</b>",
        f"refused: <b>{workspace}</b> at the workspace, <b>{force}</b> by force",
    ]
    words += [
        f"{text(curve.name)}: p <b>{curve.probabilities[scene.step]:.2f}</b>, "
        f"grade <b>{curve.grades[scene.step]:.1f}</b>"
        for curve in scene.curves
    ]
    if scene.truth is not None:
        truth = scene.truth
        words.append(f"true view <b>{text(truth.view)}</b>, grade <b>{truth.grade:.1f}</b>")
        words.append(
            f"to the nominal pose <b>{truth.millimetres:.0f} mm</b>, <b>{truth.degrees:.0f}°</b>"
        )
    return f'<div class="rs-state">{"".join(f"<span>{word}</span>" for word in words)}</div>'


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
