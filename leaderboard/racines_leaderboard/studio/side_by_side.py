"""Generators side by side at one pose: sliders, presets, and what each draws there.

A damaged dataset, and what was not offered, raise a `RacinesError`.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from PIL import Image

from racines_data.errors import RacinesError
from racines_data.geometry import geodesic, parameters_to_pose, pose_to_parameters
from racines_data.phantom.anatomy import anatomy_views
from racines_data.schema import PARAMETERS
from racines_data.views import HEART, PAPER_STATISTICS
from racines_leaderboard.board.collect import boards, read_board
from racines_leaderboard.studio import inputs, parts
from racines_leaderboard.studio.html import element, quick_png, text
from racines_leaderboard.studio.parts import Place, load_phantom, load_store
from racines_models.scores.metrics import psnr, ssim

MOST = 12
"""Generators that draw at once, at most."""
GROUPS = (
    ("position", "mm", 1e3, 0.5),
    ("rotation", "rad", 1.0, 0.01),
    ("force", "N", 1.0, 0.1),
    ("torque", "N·m", 1.0, 0.01),
)
"""Name, shown unit, shown units in one SI unit, and step, of three parameters each."""
NOMINAL = "nominal "


@dataclass(frozen=True)
class Slider:
    """One of the twelve parameters, in the unit that is shown."""

    name: str
    unit: str
    scale: float
    """Shown units in one SI unit."""
    low: float
    high: float
    step: float

    def shown(self, value: float) -> float:
        """Return an SI value in the shown unit, within the slider; 0 N where it is unknown."""
        value = 0.0 if math.isnan(value) else value * self.scale
        return min(max(round(value, 3), self.low), self.high)


@dataclass(frozen=True)
class Card:
    """One image at the pose."""

    title: str
    image: np.ndarray
    """(128, 128) uint8."""
    notes: tuple[str, ...]


def sliders(place: Place) -> tuple[Slider, ...]:
    """Return the twelve sliders; they reach as far as the dataset, or else the paper's table."""
    store = load_store(place)
    if store is None:
        spans = [(PAPER_STATISTICS[n].minimum, PAPER_STATISTICS[n].maximum) for n in PARAMETERS]
    else:
        columns = store.parameters.double().numpy()
        spans = zip(np.nanmin(columns, 0), np.nanmax(columns, 0), strict=True)
    reach: dict[str, Any] = dict(zip(PARAMETERS, spans, strict=True))
    return tuple(
        _slider(name, unit, scale, step, *reach[name])
        for group, unit, scale, step in GROUPS
        for name in (f"{group}_{axis}" for axis in "xyz")
    )


def _slider(
    name: str, unit: str, scale: float, step: float, low: float, high: float
) -> Slider:  # fmt: skip
    """Round the span outwards to whole steps; angles that wrap go all the way round."""
    if name in ("rotation_x", "rotation_z"):
        return Slider(name, unit, scale, -3.15, 3.15, step)
    if not (math.isfinite(low) and math.isfinite(high)):  # no force was measured
        low, high = -1.0, 1.0
    low, high = math.floor(low * scale / step) * step, math.ceil(high * scale / step) * step
    return Slider(name, unit, scale, round(low, 3), round(max(high, low + step), 3), step)


def first(place: Place) -> list[float]:
    """Return where the sliders stand at first: at the best frame of the first view, if any."""
    store = load_store(place)
    of_view = [] if store is None else (store.views == 0).nonzero().squeeze(1)
    if store is None or not len(of_view):
        return [h.shown((h.low + h.high) / 2 / h.scale) for h in sliders(place)]
    best = of_view[store.grades[of_view].nan_to_num(-1.0).argmax()]
    return _to_sliders(place, store.parameters[best].tolist())


def leading(place: Place, offered: Sequence[str]) -> list[str]:
    """Return the offered generators, those with the highest SSIM on any board first."""
    best: dict[str, float] = {}
    try:
        contents = [read_board(place.results, board) for board in boards(place.results)]
    except RacinesError:  # damaged results close their own tab, not this one
        contents = []
    for record in (record for content in contents for record in content["generators"]):
        ssim = record["scores"]["metrics"]["ssim"]["value"]
        best[record["name"]] = max(best.get(record["name"], 0.0), ssim or 0.0)
    return sorted(offered, key=lambda label: -best.get(label, 0.0))


def presets(place: Place) -> list[str]:
    """Return the names of the poses that can be set: the nominal one of each view."""
    store = load_store(place)
    views = anatomy_views(HEART) if store is None else store.labels[:-1]
    return [f"{NOMINAL}{view}" for view in views]


def preset(place: Place, name: Any) -> list[float]:
    """Return the sliders' values at a preset, with the forces that the probe feels there."""
    view = inputs.choice(name, presets(place), "pose").removeprefix(NOMINAL)
    phantom = load_phantom(place)
    pose = phantom.target(view)
    return _to_sliders(place, pose_to_parameters(pose, phantom.wrench(pose))[0].tolist())


def frame(place: Place, turn: int) -> tuple[list[float], str]:
    """Return the sliders' values at a drawn frame of the test split, and which frame it is.

    The n-th draw of a Studio is always the same frame.
    """
    store = load_store(place)
    rows = [] if store is None else store.order("test", place.seed)
    if store is None or not len(rows):
        raise RacinesError("no test frames: build a dataset with `racines data build`")
    row = int(rows[turn % len(rows)])
    which = store.trajectories[int(store.trajectory_index[row])]
    values = _to_sliders(place, store.parameters[row].tolist())
    return values, f"frame {int(store.frame[row])} of {which}"


def _to_sliders(place: Place, parameters: Sequence[float]) -> list[float]:
    known: dict[str, float] = dict(zip(PARAMETERS, parameters, strict=True))
    return [slider.shown(known[slider.name]) for slider in sliders(place)]


def read_parameters(place: Place, values: Sequence[Any]) -> Any:
    """Return (1, 12) float32 parameters, SI, of the sliders' values as a browser sent them."""
    all_sliders = sliders(place)
    if len(values) != len(all_sliders):
        raise RacinesError(f"{len(values)} parameters: give {len(all_sliders)}")
    chosen = {
        slider.name: inputs.number(value, slider.low, slider.high, slider.name) / slider.scale
        for slider, value in zip(all_sliders, values, strict=True)
    }
    return torch.tensor([[chosen[name] for name in PARAMETERS]], dtype=torch.float32)


def draw_cards(place: Place, values: Sequence[Any], seed: Any, ticked: Any) -> list[Card]:
    """Return the phantom's image, the nearest frame, and an image of each ticked generator."""
    parameters = read_parameters(place, values)
    seed = inputs.whole(seed, 0, inputs.GREATEST_SEED, "seed")
    offered = parts.trained_generators(place)
    chosen = inputs.choices(ticked, tuple(offered), "generators")
    if len(chosen) > MOST:
        raise RacinesError(f"generators: tick at most {MOST}")
    phantom = load_phantom(place)
    drawn = [("phantom", phantom.generate(parameters, seed), _of_truth(phantom, parameters))]
    drawn += _nearest(place, parameters)
    for label in chosen:
        began = time.perf_counter()
        image = parts.load_trained(*offered[label], place.device).generate(parameters, seed)
        drawn.append((label, image, f"{1e3 * (time.perf_counter() - began):.0f} ms"))
    images = torch.cat([image.cpu() for _, image, _ in drawn])
    notes = zip(_likeness(images), _judgement(place, phantom, images), strict=True)
    return [
        Card(title, image[0].cpu().numpy(), tuple(note for note in (said, *both) if note))
        for (title, image, said), both in zip(drawn, notes, strict=True)
    ]


def _of_truth(phantom: Any, parameters: Any) -> str:
    """Return what the phantom says of the pose, and whether tasks go there."""
    truth = phantom.truth(parameters)
    said = f"truth: {phantom.labels[int(truth.view[0])]}, grade {float(truth.grade[0]):.1f}"
    inside = bool(phantom.workspace.contains(parameters_to_pose(parameters))[0])
    return said if inside else f"{said}; outside the workspace"


def _nearest(place: Place, parameters: Any) -> list[tuple[str, Any, str]]:
    """Return the frame of the dataset whose pose is nearest, and how far off it is, if any."""
    index, store = parts.load_index(place), load_store(place)
    if index is None:
        return []
    row = index.nearest(parameters)[0]
    there, here = parameters_to_pose(store.parameters[row]), parameters_to_pose(parameters)
    metres = float((there.position - here.position).norm())
    turn = math.degrees(float(geodesic(there.rotation, here.rotation)))
    label = store.labels[int(store.views[row])] if int(store.views[row]) >= 0 else "no label"
    said = f"{1e3 * metres:.1f} mm and {turn:.1f}° off; labelled {label}"
    return [("nearest frame", store.images[row], said)]


def _likeness(images: Any) -> list[str]:
    """Return SSIM and PSNR of (N, 128, 128) images against the first; nothing for that one."""
    truth = images[:1].expand(len(images), -1, -1)
    pairs = zip(ssim(images, truth).tolist(), psnr(images, truth).tolist(), strict=True)
    return ["", *(f"SSIM {a:.3f}, PSNR {b:.1f} dB" for a, b in list(pairs)[1:])]


def _judgement(place: Place, phantom: Any, images: Any) -> list[str]:
    """Return what the grader sees in (N, 128, 128) images; nothing without a grader."""
    grader = parts.load_grader(place, phantom.labels)
    if grader is None:
        return [""] * len(images)
    p, grades = grader.probabilities_and_grade(images)
    best, views = p.max(1)
    rows = zip(views.tolist(), best.tolist(), grades.tolist(), strict=True)
    return [f"judge: {grader.labels[v]} (p {b:.2f}), grade {g:.1f}" for v, b, g in rows]


def cards_page(cards: Sequence[Card]) -> str:
    """Return all cards as one grid, as many side by side as there is room for."""
    page = ""
    for card in cards:
        image = element(quick_png(Image.fromarray(card.image)), f"image by {card.title}", "")
        notes = "".join(f"<span>{text(note)}</span>" for note in card.notes)
        caption = f"<figcaption><b>{text(card.title)}</b>{notes}</figcaption>"
        page += f'<figure class="rg-card">{image}{caption}</figure>'
    return f'<div class="rg-cards">{page}</div>'
