"""One moment of an episode: what a page shows of it, taken from a core, and how, as HTML."""

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from PIL import Image

from racines_data.plotting import LINE, PALE, PROBE, TRUTH, WARNING, WORDS
from racines_envs.apis.rendering import block_views
from racines_envs.task.actions import ACTIONS
from racines_envs.task.tasks import DECLARED
from racines_leaderboard.studio.html import element, quick_png, text

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
class Scene:
    """One moment of an episode."""

    task: Any
    step: int
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
    refused: tuple[int, int, int]
    """Steps that were refused at the workspace, at the force limit, and by the arm."""
    curves: tuple[Curve, ...]
    needed: tuple[float, float]
    """p and grade of a hit."""
    ended: str
    """Why the episode is over; empty while it is not."""
    success: bool
    truth: tuple[str, str] | None
    """What the phantom knows and an agent is not told, as HTML; None where it is hidden."""


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


def judged(grader: Any, images: Sequence[Any], target: int) -> tuple[list[float], list[float]]:
    """Return p of the target view, and the grade, that a grader gives each (1, 128, 128) image."""
    p, grades = grader.probabilities_and_grade(torch.cat(list(images)))
    return p[:, target].tolist(), grades.tolist()


def take_scene(
    core: Any, moment: Snapshot, steps: Any, curves: Sequence[Curve], truth: bool
) -> Scene:
    """Return what a page shows of a moment of a core; `steps` are those so far."""
    core, info = copy.copy(core), moment.info
    core.state = moment.state
    task, last = core.task, steps.actions[-1]
    above, front = block_views(core, 0, steps, truth, ZOOM)
    return Scene(
        task=task,
        step=int(info["steps"]),
        action="start" if last is None else ACTIONS[last],
        image=moment.image[0].cpu().numpy(),
        above=above,
        front=front,
        force=info["force"],
        limit=task.force_limit,
        peak=info["peak_force"],
        wrench=tuple(core.state.wrench[0].tolist()),
        refused=(
            int(info["workspace_hits"]),
            int(info["force_hits"]),
            int(info.get("arm_hits", 0)),
        ),
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
    if task.termination == DECLARED and int(core.state.idle[0]) >= task.idles:
        return f"declared by {task.idles} steps of staying, and {shown}"
    return f"all {task.max_steps} steps are taken, and {shown}"


def _truth(core: Any, info: dict[str, Any]) -> tuple[str, str]:
    view = text(core.phantom.labels[int(info["view"])])
    millimetres, degrees = 1e3 * info["position_error"], math.degrees(info["rotation_error"])
    return (
        f"true view <b>{view}</b>, grade <b>{info['grade']:.1f}</b>",
        f"to the nominal pose <b>{millimetres:.0f} mm</b>, <b>{degrees:.0f}°</b>",
    )


COLOURS = {"grader": PROBE, "truth": TRUTH}
WIDE, HIGH = 360, 118
"""Of a drawing, in its own units; it is drawn as wide as its place."""
LEFT, RIGHT, TOP, BOTTOM = 30, 350, 24, 98
FULL_FORCE = 1.25
"""Right end of the force gauge, in force limits."""


def panels(scene: Scene) -> tuple[str, str]:
    """Return the two halves of a page: the image with its state, and what stands beside it."""
    return image_panel(scene), side_panel(scene)


def image_panel(scene: Scene, image: np.ndarray | None = None) -> str:
    """Return the ultrasound image and the state in words; `image` in place of the scene's."""
    shown = scene.image if image is None else image
    alt = f"{scene.task.id}, step {scene.step}: ultrasound image"
    scan = f'<div class="rs-scan">{element(quick_png(Image.fromarray(shown)), alt, "")}</div>'
    mark = "rc-done" if scene.success else "rc-refused"
    over = f'<p class="{mark}">The episode is over: {text(scene.ended)}.</p>'
    return f"{scan}{state_line(scene)}{over if scene.ended else ''}"


def state_line(scene: Scene) -> str:
    """Return step, refusals, judgement and, where it is shown, the truth."""
    workspace, force, arm = scene.refused
    words = [
        f"<b>{text(scene.task.id)}</b>",
        f"step <b>{scene.step}</b> of {scene.task.max_steps}",
        f"last: <b>{text(scene.action)}</b>",
        f"refused: <b>{workspace}</b> at the workspace, <b>{force}</b> by force"
        + (f", <b>{arm}</b> by the arm" if arm else ""),
    ]
    words += [
        f"{text(curve.name)}: p <b>{curve.probabilities[scene.step]:.2f}</b>, "
        f"grade <b>{curve.grades[scene.step]:.1f}</b>"
        for curve in scene.curves
    ]
    spans = "".join(f"<span>{word}</span>" for word in (*words, *(scene.truth or ())))
    return f'<div class="rs-state">{spans}</div>'


def side_panel(scene: Scene) -> str:
    """Return force gauge, curves and the probe over the block."""
    p, grade = scene.needed
    grades = [(curve.name, curve.grades) for curve in scene.curves]
    probabilities = [(curve.name, curve.probabilities) for curve in scene.curves]
    pictures = ""
    for place, view in (("above", scene.above), ("the front", scene.front)):
        few = view.quantize(48, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        pictures += element(quick_png(few), f"probe from {place}", "")
    return (
        force_gauge(scene)
        + _chart(f"grade as {scene.task.view}", grades, scene.step, 10.0, grade)
        + _chart(f"probability of {scene.task.view}", probabilities, scene.step, 1.0, p)
        + f'<div class="rs-block">{pictures}</div>'
    )


def force_gauge(scene: Scene) -> str:
    """Return the normal force as a bar with its limit and its peak, and the wrench in numbers."""

    def at(force: float) -> float:
        share = force / (FULL_FORCE * scene.limit)
        return LEFT + (RIGHT - LEFT) * min(max(share, 0.0), 1.0)

    now, limit, peak = at(scene.force), at(scene.limit), at(scene.peak)
    colour = WARNING if scene.force > 0.9 * scene.limit else TRUTH
    title = f"normal force {scene.force:.1f} N"
    bar = f'<rect x="{LEFT}" y="24" height="16" width='
    drawn = [
        _words(LEFT, 16, title),
        _words(RIGHT, 16, f"peak {scene.peak:.1f} N, limit {scene.limit:.0f} N", "end"),
        f'{bar}"{RIGHT - LEFT}" fill="{LINE}"/>',
        f'{bar}"{now - LEFT:.1f}" fill="{colour}"/>',
        _line(peak, peak, 22, 42, WORDS),
        _line(limit, limit, 20, 44, WARNING, 'stroke-width="2.5"'),
    ]
    force, torque = (
        ", ".join(f"{axis} {value:+.{digits}f}" for axis, value in zip("xyz", values, strict=True))
        for values, digits in ((scene.wrench[:3], 1), (scene.wrench[3:], 2))
    )
    numbers = f'<p class="rs-wrench">force {force} N · torque {torque} N·m</p>'
    return _svg(drawn, 50, title) + numbers


def _chart(
    title: str, curves: Sequence[tuple[str, Sequence[float]]], step: int, full: float, needed: float
) -> str:
    """Return one quantity of all curves over the steps, with what a hit needs."""
    steps = max(20, *(len(values) - 1 for _, values in curves), 0)

    def at(step: float, share: float) -> tuple[float, float]:
        share = min(max(share, 0.0), 1.0)
        return LEFT + (RIGHT - LEFT) * step / steps, BOTTOM - (BOTTOM - TOP) * share

    drawn = [_words(LEFT, 15, title)]
    for share, anchor in ((0.0, "start"), (0.5, "middle"), (1.0, "end")):
        x, y = at(share * steps, share)
        drawn.append(_line(LEFT, RIGHT, y, y, LINE))
        drawn.append(_words(LEFT - 5, y + 4, f"{share * full:g}", "end"))
        drawn.append(_words(x, BOTTOM + 14, f"{share * steps:.0f}", anchor))
    level = at(0, needed / full)[1]
    drawn.append(_line(LEFT, RIGHT, level, level, PALE, 'stroke-dasharray="4 4"'))
    for place, (name, values) in enumerate(curves):
        colour = COLOURS.get(name, WORDS)
        points = [at(i, value / full) for i, value in enumerate(values)]
        path, (x, y) = " ".join(f"{x:.1f},{y:.1f}" for x, y in points), points[step]
        drawn += [
            _words(RIGHT - 60 * place, 15, name, "end", colour),
            f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="2"/>',
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="{colour}"/>',
        ]
    if not curves:
        drawn.append(_words((LEFT + RIGHT) / 2, 64, "no grader here: show the truth", "middle"))
    drawn.append(_words((LEFT + RIGHT) / 4 * 3, BOTTOM + 14, "steps", "middle"))
    return _svg(drawn, HIGH, f"{title} over the steps")


def _line(x1: float, x2: float, y1: float, y2: float, colour: str, more: str = "") -> str:
    ends = f'x1="{x1:.1f}" x2="{x2:.1f}" y1="{y1:.1f}" y2="{y2:.1f}"'
    return f'<line {ends} stroke="{colour}" {more}/>'


def _words(x: float, y: float, words: str, anchor: str = "start", colour: str = "") -> str:
    fill = f' style="fill:{colour}"' if colour else ""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{fill}>{text(words)}</text>'


def _svg(drawn: Sequence[str], height: int, alt: str) -> str:
    box = f'viewBox="0 0 {WIDE} {height}" role="img" aria-label="{text(alt)}"'
    return f'<svg class="rs-draw" {box}>{"".join(drawn)}</svg>'
