"""Pictures of an episode: the image, the probe over the block, and the trace of p and the grade.

Drawn with Pillow, in milliseconds a frame, so that driving by hand and recording keep up:

    +----------------+-----------+-----------+
    |                | from      | from      |
    |   ultrasound   | above     | the front |
    |                +-----------+-----------+
    +----------------+  p and grade over the |
    |   in words     |  steps                |
    +----------------+-----------------------+
"""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from PIL import Image, ImageDraw
from torch import Tensor

from racines_data.phantom.config import ProbeConfig
from racines_data.plotting import (
    LINE,
    MUTED,
    NIGHT,
    PALE,
    PANEL,
    PATH,
    PROBE,
    SECTOR,
    TRUTH,
    WARNING,
    WORDS,
    letters,
    mark_depth,
)
from racines_envs.robots.following import ArmRobot
from racines_envs.task.actions import ACTIONS
from racines_envs.task.core import ScanCore
from racines_envs.worlds.ward import Ward

WIDTH, HEIGHT = 960, 540
IMAGE = 384  # pixels, height and width of the ultrasound image in the picture
_MARGIN, _DEEP = 0.012, 0.14
"""Where a block of unknown size ends: about the workspace, and below the top, m."""
_BODY = 0.06  # m, length of the probe's body as drawn

_SIDE = 286, 318
_ABOVE, _FRONT = (IMAGE + 2, 0), (IMAGE + 290, 0)
"""Size and places of the views of the block."""
_TRACE = IMAGE + 2, 320, WIDTH, HEIGHT


@dataclass
class Steps:
    """What one row has done since its reset; entry 0 is the start, where the action is None.

    Positions are in m; probabilities and grades are p and g by the reward's own source.
    """

    actions: list[Any] = field(default_factory=list)
    positions: list[list[float]] = field(default_factory=list)
    probabilities: list[float] = field(default_factory=list)
    grades: list[float] = field(default_factory=list)


class History:
    """The steps of every row of a core since its last reset, for pictures."""

    def __init__(self, rows: int) -> None:
        self._rows = [Steps() for _ in range(rows)]

    def __getitem__(self, row: int) -> Steps:
        return self._rows[row]

    def note(self, core: ScanCore, actions: Tensor | None = None) -> None:
        """Add the present state of all rows, after actions of each or a reset.

        A row at step 0 begins anew; a row that has ended and was not reset stays as it is.
        """
        state, score = core.state, core.score
        columns = [state.steps, state.position, score.probability, score.grade]
        chosen = [None] * core.num_envs if actions is None else actions.tolist()
        rows = zip(self._rows, chosen, *(column.tolist() for column in columns), strict=True)
        for steps, action, count, position, probability, grade in rows:
            if count == 0:
                for entries in vars(steps).values():
                    entries.clear()
            if count >= len(steps.positions):
                steps.actions.append(action if count else None)
                steps.positions.append(position)
                steps.probabilities.append(probability)
                steps.grades.append(grade)


@torch.no_grad()
def compose(core: ScanCore, row: int = 0, history: History | None = None) -> np.ndarray:
    """Draw a row of a core as (540, 960, 3) uint8.

    Without a history of its steps the path and the trace hold the present alone.
    """
    if history is None:
        history = History(core.num_envs)
        history.note(core)
    steps = history[row]
    picture = Image.new("RGB", (WIDTH, HEIGHT), NIGHT)
    picture.paste(_ultrasound(core, row), (0, 0))
    for view, place in zip(block_views(core, row, steps), (_ABOVE, _FRONT), strict=True):
        picture.paste(view, place)
    draw = ImageDraw.Draw(picture)
    _draw_trace(draw, core, steps)
    for line, (text, colour) in enumerate(_words(core, row, steps)):
        draw.text((12, IMAGE + 8 + 21 * line), text, colour, letters(14))
    return np.asarray(picture)


def block_views(
    core: ScanCore, row: int, steps: Steps, goal: bool = True, zoom: int = 1
) -> tuple[Image.Image, Image.Image]:
    """Draw the probe over the block, from above and from the front; `zoom` × 286 × 318 pixels.

    With `goal` the nominal pose is drawn, which an agent is not told.
    """
    above = _view(core, row, steps, (0, 1), "from above", goal, zoom)
    return above, _view(core, row, steps, (0, 2), "from the front", goal, zoom)


def describe(core: ScanCore, row: int, steps: Steps) -> list[str]:
    """Return what the picture says in words: step, view and grade, p, force, errors, return."""
    return [text for text, _ in _words(core, row, steps)]


def _ultrasound(core: ScanCore, row: int) -> Image.Image:
    """Return the image enlarged, with its depth where the size of a pixel is known."""
    small = Image.fromarray(core.picture()[row].cpu().numpy())
    gray = small.resize((IMAGE, IMAGE), Image.Resampling.BILINEAR)
    pixel = _pixel(core, row)
    if pixel is not None:
        mark_depth(gray, pixel * small.width / IMAGE)
    return gray


def _pixel(core: ScanCore, row: int) -> float | None:
    """Return the side of an image's pixel, mm; None of what was recorded."""
    if isinstance(core.phantom, Ward):
        return float(core.phantom.pool.pixel_size(core.state.case[row : row + 1])[0])
    if core.phantom.config is None:
        return None
    return 1e3 * core.phantom.config.probe.pixel_size


def _words(core: ScanCore, row: int, steps: Steps) -> list[tuple[str, str]]:
    info = {name: value[row].item() for name, value in core.info(view_error=False).items()}
    task, action = core.task, steps.actions[-1] if steps.actions else None
    moved = "start" if action is None else _moved(action)
    goal = core.phantom.views[int(core.state.goal[row])]
    force, refused = info["force"], info["workspace_hits"] + info["force_hits"]
    refused += info.get("arm_hits", 0)
    unit = getattr(core.phantom, "unit", "mm")
    away, turned = info["position_error"] * 1e3, math.degrees(info["rotation_error"])
    found = TRUTH if info["success"] else WORDS
    pressed = WARNING if force > 0.9 * task.force_limit else WORDS
    rows = [
        (f"{task.id}    step {info['steps']:.0f} / {task.max_steps}    {moved}", WORDS),
        (f"true view {core.phantom.labels[int(info['view'])]}, grade {info['grade']:.1f}", found),
        (f"p {info['probability']:.2f}    grade as {goal} {info['score']:.1f}", WORDS),
        (
            f"force {force:.1f} N of {task.force_limit:.0f} N    refused steps {refused:.0f}",
            pressed,
        ),
        (f"to nominal {away:.0f} {unit}, {turned:.0f} deg    return {info['return']:.1f}", WORDS),
    ]
    if info.get("out_of_support"):
        rows.append(("nothing was recorded near this pose", WARNING))
    if bool(core.state.done[row]):
        rows.append(("the episode has ended", found))
    return rows


def _moved(action: int | list[float]) -> str:
    """Return an action in words; of a twist how fast it shifts and turns the probe."""
    if isinstance(action, int):
        return ACTIONS[action]
    along, about = math.hypot(*action[:3]) * 1e3, math.degrees(math.hypot(*action[3:]))
    return f"{along:.0f} mm/s, {about:.0f} deg/s"


def _arm(core: ScanCore, row: int) -> np.ndarray:
    """Return the (n, 3) m along the arm, from its base to the tip; none of a free probe."""
    if not isinstance(core.robot, ArmRobot):
        return np.empty((0, 3))
    return core.robot.kinematics.points(core.state.joints[row : row + 1])[0].cpu().numpy()


def _bounds(core: ScanCore) -> np.ndarray:
    """Return the block's least and greatest corner, m; from the workspace where no block is."""
    if core.phantom.config is not None:
        block = core.phantom.config.block
        return np.array([block.minimum, block.maximum])
    low, high = _workspace(core)
    height = core.phantom.surface_height
    top = float(low[2] if height is None else height)
    return np.stack([np.append(low[:2] - _MARGIN, top - _DEEP), np.append(high[:2] + _MARGIN, top)])


def _workspace(core: ScanCore) -> np.ndarray:
    space = core.phantom.workspace
    return torch.stack([space.position_min, space.position_max]).cpu().numpy()


def _view(
    core: ScanCore, row: int, steps: Steps, axes: tuple[int, int], title: str, goal: bool, zoom: int
) -> Image.Image:
    """Draw block, workspace, sector, path, nominal pose and probe, projected on two axes."""
    block = _bounds(core)
    panel = Image.new("RGB", (_SIDE[0] * zoom, _SIDE[1] * zoom), PANEL)
    draw = ImageDraw.Draw(panel)
    arm = _arm(core, row)
    corners = np.stack([block[0], block[1] + np.array([0.0, 0.0, _BODY + 0.02])])
    shown = np.concatenate([corners, arm])
    to_pixels = _projection(shown.min(0), shown.max(0), axes, zoom)

    def box(corners: np.ndarray) -> tuple[float, ...]:
        (left, bottom), (right, top) = to_pixels(corners)
        return left, top, right, bottom

    probe = ProbeConfig() if core.phantom.config is None else core.phantom.config.probe
    pose = [x[row].cpu().numpy() for x in core.state.pose]
    draw.rectangle(box(block), outline=MUTED, fill=LINE)
    draw.polygon(to_pixels(_fan(probe, *pose)), outline=PROBE, fill=SECTOR)
    draw.rectangle(box(_workspace(core)), outline=PALE)
    if goal:
        # Of all rows one, or one each.
        target = (x[min(row, len(x) - 1)].cpu().numpy() for x in core.target)
        _draw_probe(draw, to_pixels, probe, *target, colour=TRUTH, width=2 * zoom)
    if len(steps.positions) > 1:
        path = to_pixels(np.array(steps.positions))
        draw.line(path, fill=PATH, width=2 * zoom)
        draw.circle(path[0], 4 * zoom, fill=PATH)
    if len(arm):
        links = to_pixels(arm)
        draw.line(links, fill=PALE, width=5 * zoom, joint="curve")
        for place in links[:-1]:
            draw.circle(place, 4 * zoom, fill=PANEL, outline=PALE, width=2 * zoom)
    _draw_probe(draw, to_pixels, probe, *pose, colour=PROBE, width=(2 if len(arm) else 3) * zoom)
    across, up = ("xyz"[axis] for axis in axes)
    label, font = f"{title}    {across} to the right, {up} up", letters(13 * zoom)
    draw.text((8 * zoom, 6 * zoom), label, WORDS, font)
    names = (("probe", PROBE), ("nominal", TRUTH), ("path", PATH), ("workspace", PALE))
    for index, (text, colour) in enumerate(names):
        if goal or text != "nominal":
            place = (10 + 66 * index) * zoom, (_SIDE[1] - 22) * zoom
            draw.text(place, text, colour, font)
    return panel


def _projection(low: np.ndarray, high: np.ndarray, axes: tuple[int, int], zoom: int) -> Any:
    """Return a function from (n, 3) m to a list of pixels: one scale, centred, upwards."""
    a, size = list(axes), (high - low)[list(axes)]
    scale = zoom * min((_SIDE[0] - 30) / size[0], (_SIDE[1] - 62) / size[1])
    middle, centre = (low + high)[a] / 2, zoom * np.array(_SIDE) / 2

    def to_pixels(points: np.ndarray) -> list[tuple[float, float]]:
        flat = (np.atleast_2d(points)[:, a] - middle) * scale * np.array([1.0, -1.0]) + centre
        return [(float(x), float(y)) for x, y in flat]

    return to_pixels


def _fan(probe: ProbeConfig, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return the outline of the image plane's sector, (n, 3) m."""
    angle = np.linspace(-probe.half_angle, probe.half_angle, 9)
    rim = np.stack([np.sin(angle), np.zeros(9), np.cos(angle)], 1) * probe.depth
    return np.concatenate([np.zeros((1, 3)), rim]) @ rotation.T + position


def _draw_probe(
    draw: ImageDraw.ImageDraw, to_pixels: Any, probe: ProbeConfig, position: np.ndarray,
    rotation: np.ndarray, colour: str, width: int,
) -> None:  # fmt: skip
    """Draw the probe's body behind its face, and a mark at the image's right side."""
    x, y = probe.aperture / 2, probe.thickness / 2
    face = np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]])
    body = np.array([[-x, 0, 0], [-x, 0, -_BODY], [x, 0, -_BODY], [x, 0, 0]])
    for outline in (body, face):
        points = to_pixels(outline @ rotation.T + position)
        draw.line([*points, points[0]], fill=colour, width=width, joint="curve")
    mark = to_pixels(np.array([1.3 * x, 0, 0]) @ rotation.T + position)[0]
    draw.circle(mark, width + 1, fill=colour)


def _draw_trace(draw: ImageDraw.ImageDraw, core: ScanCore, steps: Steps) -> None:
    """Draw p and g / 10 over the steps, with the thresholds of a hit."""
    left, top, right, bottom = _TRACE[0] + 44, _TRACE[1] + 30, _TRACE[2] - 44, _TRACE[3] - 28
    draw.rectangle(_TRACE, fill=PANEL)
    draw.rectangle((left, top, right, bottom), outline=MUTED)
    count = max(20, len(steps.probabilities) - 1)

    def at(step: float, share: float) -> tuple[float, float]:
        return left + (right - left) * step / count, bottom - (bottom - top) * share

    curves = (
        ("p", steps.probabilities, core.rewards.probability, 1.0, PROBE),
        ("grade", steps.grades, core.rewards.grade, 10.0, PATH),
    )
    for name, values, threshold, full, colour in curves:
        _, y = at(0, threshold / full)
        for x in range(left, right, 8):
            draw.line((x, y, x + 3, y), fill=colour)
        points = [at(i, min(max(v / full, 0.0), 1.0)) for i, v in enumerate(values)]
        if len(points) > 1:
            draw.line(points, fill=colour, width=2, joint="curve")
        if points:
            draw.circle(points[-1], 3, fill=colour)
        end, anchor = (left - 6, "rm") if name == "p" else (right + 6, "lm")
        for share in (0.0, 0.5, 1.0):
            draw.text(
                (end, at(0, share)[1]), f"{share * full:g}", colour, letters(12), anchor=anchor
            )
    title = f"as {core.task.view} by the {core.reward.judged_by}:"
    said, place = letters(12), float(left)
    for text, colour in (
        (title, WORDS), ("p (left)", PROBE), ("grade (right)", PATH),
        ("dashed: what a hit needs", PALE),
    ):  # fmt: skip
        draw.text((place, top - 20), text, colour, said)
        place += said.getlength(text) + 10
    for share in (0.0, 0.5, 0.75, 1.0):
        place = (left + (right - left) * share, bottom + 6)
        text = "steps" if share == 0.75 else f"{count * share:.0f}"
        draw.text(place, text, WORDS, letters(12), anchor="ma")
