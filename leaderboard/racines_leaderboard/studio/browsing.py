"""The dataset by trajectory: which there are, and one of them frame by frame as HTML.

Each figure is drawn once a trajectory; where in it a frame lies is told in shares of its width and
height, so that a page can move a mark over the picture instead of drawing it again. What was not
offered raises a `RacinesError`, and so does a damaged store.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.proj3d import proj_transform
from PIL import Image

from racines_data.card.contact_sheet import coloured
from racines_data.card.plots import block_axes
from racines_data.errors import RacinesError
from racines_data.files import image_bytes
from racines_data.geometry import parameters_to_pose
from racines_data.manifest import ADDED, MANIFEST, STORES, store_name
from racines_data.plotting import MUTED, evenly, view_colours
from racines_data.schema import PARAMETERS, SPLITS
from racines_data.store.frames import FrameStore
from racines_leaderboard.studio.html import drawn, element, note, table, ultrasound
from racines_leaderboard.studio.inputs import choice, whole
from racines_leaderboard.studio.parts import Shared, shared_store

ALL = "all"
LISTED = 500
"""Trajectories offered at a time; filters bring the others."""
BEAMS, BEAM = 12, 10.0
"""How many times along a path the beam's direction is drawn, and how long, mm."""
QUANTITIES = (
    ("force", "N", 1.0),
    ("torque", "N·m", 1.0),
    ("position", "mm", 1e3),
    ("rotation", "°", 180.0 / math.pi),
)
"""Name, shown unit, and shown units in one SI unit, of three parameters each."""


@dataclass(frozen=True)
class Trajectory:
    """One trajectory of T frames."""

    store: FrameStore
    name: str
    target_view: str
    session: str
    split: str
    first: int
    """Row of its first frame."""
    frames: int

    @property
    def rows(self) -> slice:
        """Its rows of the store."""
        return slice(self.first, self.first + self.frames)

    @property
    def times(self) -> np.ndarray:
        """(T,) seconds since its first frame; frame numbers where the data have no time."""
        stamps = self.store.timestamps[self.rows].numpy()
        return stamps - stamps[0] if self.timed else np.arange(self.frames, dtype=np.float64)

    @property
    def timed(self) -> bool:
        """Whether the data have times."""
        return bool(self.store.timestamps[self.rows].isfinite().all())

    @property
    def colour(self) -> str:
        """The colour of its target view."""
        return view_colours(self.store.labels).get(self.target_view, MUTED)


def configs(root: Path | None) -> list[str]:
    """Return the configs of a dataset that can be browsed; none where there is no dataset."""
    if root is None or not (root / MANIFEST).is_file():
        return []
    return [name for name in STORES if (root / store_name(name)).is_file()]


def opened(root: Path | None, config: Any) -> FrameStore:
    """Open a config's store; the same one for everybody, until the dataset is built anew."""
    config = choice(config, configs(root), "data")
    assert root is not None
    return shared_store(root, config)


def trajectories(store: FrameStore, split: Any, view: Any) -> list[str]:
    """Return the first trajectories of a split, or of one target view of it, by name."""
    split = choice(split, SPLITS, "split")
    view = choice(view, (ALL, *store.labels), "view")
    low, high = store.bounds(split)
    present = torch.unique_consecutive(store.trajectory_index[low:high]).tolist()
    fitting = [i for i in present if view in (ALL, store.target_views[i])]
    return [store.trajectories[i] for i in fitting[:LISTED]]


def trajectory(store: FrameStore, name: Any) -> Trajectory:
    """Return a trajectory by its name."""
    name = choice(name, store.trajectories, "trajectory")
    index = store.trajectories.index(name)
    # Rows of a trajectory are neighbours, and lie in one split.
    rows = torch.nonzero(store.trajectory_index == index).flatten()
    if not len(rows):
        raise RacinesError(f"trajectory {name}: has no frames")
    first = int(rows[0])
    split = next(s for s in SPLITS if first in range(*store.bounds(s)))
    target, session = store.target_views[index], store.sessions[index]
    return Trajectory(store, name, target, session, split, first, len(rows))


def frame_of(chosen: Trajectory, frame: Any) -> int:
    """Return the place of a frame, 0 to T - 1, from its number on the page, 1 to T."""
    return whole(frame, 1, chosen.frames, "frame") - 1


@dataclass(frozen=True)
class Marked:
    """A picture and where in it each of T frames lies."""

    png: bytes
    places: np.ndarray
    """(T, 2) shares of the width from the left and of the height from the top."""


_drawings: Shared[tuple[Marked, Marked | None]] = Shared(64)


def grades_figure(trajectory: Trajectory) -> Marked:
    """Draw the grade over time, shaded where the target view is shown."""
    store, rows, aim = trajectory.store, trajectory.rows, trajectory.target_view
    times, grades = trajectory.times, store.grades[rows].numpy()

    def draw(figure: Figure) -> None:
        axis = figure.add_axes((0.09, 0.22, 0.89, 0.63))
        if aim in store.labels[:-1]:
            aimed = store.views[rows].numpy() == store.labels.index(aim)
            axis.fill_between(times, 0, 10, where=aimed, color=trajectory.colour, alpha=0.15, lw=0)
        axis.plot(times, grades, color=trajectory.colour, lw=1.6)
        if not np.isfinite(grades).any():
            axis.text(0.5, 0.5, "the data have no grades", transform=axis.transAxes, ha="center")
        axis.set_ylim(0, 10)
        axis.set_yticks((0, 5, 10))
        axis.margins(x=0.01)
        axis.set_xlabel("time, s" if trajectory.timed else "frame")
        axis.set_title(f"Grade; shaded: {aim} in view")

    return _marked((5.0, 2.5), draw, lambda axis: (times, np.zeros(trajectory.frames)))


def path_figure(trajectory: Trajectory) -> Marked | None:
    """Draw the path of the probe's tip and the beam along it; None where the data have no poses."""
    parameters = trajectory.store.parameters[trajectory.rows].double()
    if not parameters[:, 6:].isfinite().all():
        return None
    pose = parameters_to_pose(parameters)
    tip, beam = 1e3 * pose.position.numpy(), pose.rotation[..., 2].numpy()
    x, y, z = tip.T

    def draw(figure: Figure) -> None:
        place = (0.0, 0.02, 0.93, 0.90)
        axis: Any = block_axes(figure, place, trajectory.store.manifest, 0.3)
        axis.plot(*tip.T, color=trajectory.colour, lw=1.8)
        for i in evenly(len(tip), BEAMS):
            axis.plot(*np.stack([tip[i], tip[i] + BEAM * beam[i]]).T, color=MUTED, lw=0.9)
        axis.set_title("Probe's tip, mm; gray: the beam", pad=0)
        for letter in "xyz":
            getattr(axis, f"set_{letter}label")(letter, labelpad=-4)
            getattr(axis, f"{letter}axis").set_major_locator(MaxNLocator(4))
        axis.tick_params(pad=-1, labelsize=7.5)
        axis.set_box_aspect((1.2, 1.0, 0.62), zoom=1.05)

    return _marked((5.0, 3.9), draw, lambda axis: proj_transform(x, y, z, axis.get_proj())[:2])


def _marked(
    size: tuple[float, float], draw: Callable[[Figure], None], points: Callable[[Any], Any]
) -> Marked:  # fmt: skip
    """Draw a figure of one axis; `points` gives the frames' x and y in the axis's coordinates."""
    png, figure = drawn(size, draw)
    axis, (width, height) = figure.axes[0], figure.bbox.size
    x, y = axis.transData.transform(np.column_stack(points(axis))).T
    return Marked(png, np.column_stack([x / width, 1.0 - y / height]))


def image_html(trajectory: Trajectory, frame: int) -> str:
    """Return a frame's image on black, with its view and grade below, and its mask over it."""
    store, row = trajectory.store, trajectory.first + frame
    label, grade = int(store.views[row]), float(store.grades[row])
    view = store.labels[label] if label >= 0 else "view unknown"
    graded = f"grade {grade:.1f}" if math.isfinite(grade) else "no grade"
    seconds = f", {trajectory.times[frame]:.2f} s" if trajectory.timed else ""
    caption = f"{view}, {graded} · frame {frame + 1} of {trajectory.frames}{seconds}"
    source = store.manifest["source"]
    simulated = "simulated" if source in ("phantom", *ADDED) else f"source: {source}"
    image = store.images[row].numpy()
    shown = ultrasound(image_bytes(Image.fromarray(image)), caption)
    if store.masks is not None:
        over = coloured(image, store.masks[row].numpy(), store.mask_labels or ())
        shown += ultrasound(image_bytes(Image.fromarray(over)), f"{caption}, with its mask")
    if store.phases is not None:
        beat, breath = store.phases[row].tolist()
        told = (("beat", beat), ("breath", breath))
        known = [f"{name} {phase:.2f}" for name, phase in told if math.isfinite(phase)]
        caption += f" · {', '.join(known)}" if known else ""
    if store.turns is not None:
        angle, away = store.turns[row].tolist()
        caption += f" · turn {angle:.1f}°, {away:.1f}° from the nearest training turn"
    return shown + note(f"{caption} · {simulated}")


def facts_html(trajectory: Trajectory) -> str:
    """Return what a trajectory is."""
    seconds = f", {trajectory.times[-1]:.1f} s" if trajectory.timed else ""
    manifest = trajectory.store.manifest
    store = trajectory.store
    index = int(store.trajectory_index[trajectory.first])
    who = f"patient {store.patients[index]}, " if store.patients else ""
    return note(
        f"{trajectory.name}: {who}{trajectory.split} split, aimed at {trajectory.target_view}, "
        f"session {trajectory.session}, {trajectory.frames} frames{seconds}. Data: "
        f"{manifest['source']} {manifest['version']}, digest {manifest['digest'][:12]}."
    )


def parameters_html(trajectory: Trajectory, frame: int) -> str:
    """Return the twelve parameters of a frame as a table."""
    values = trajectory.store.parameters[trajectory.first + frame].tolist()
    named: dict[str, float] = dict(zip(PARAMETERS, values, strict=True))
    rows = []
    for quantity, unit, scale in QUANTITIES:
        shown = (scale * named[f"{quantity}_{axis}"] for axis in "xyz")
        cells = (f"{value:.2f}" if math.isfinite(value) else "–" for value in shown)
        rows.append((f"{quantity}, {unit}", *cells))
    return table(("Quantity", *"xyz"), rows, ("rc-text", "", "", ""))


def figures_html(trajectory: Trajectory, frame: int) -> str:
    """Return the grade over time and the path in 3-D, with a mark at the frame."""
    grades, path = _drawings.get(
        trajectory, lambda: (grades_figure(trajectory), path_figure(trajectory))
    )
    x = 100 * grades.places[frame, 0]
    shown = _over(grades, "grade over time", "rc-cursor", f"left:{x:.2f}%;top:15%;height:63%")
    if path is not None:
        x, y = 100 * path.places[frame]
        shown += _over(path, "path of the probe", "rc-dot", f"left:{x:.2f}%;top:{y:.2f}%")
    return shown


def _over(picture: Marked, alt: str, css: str, place: str) -> str:
    """Return a picture with a mark over it."""
    mark = f'<div class="{css}" style="{place}"></div>'
    return f'<div class="rc-over">{element(picture.png, alt)}{mark}</div>'
