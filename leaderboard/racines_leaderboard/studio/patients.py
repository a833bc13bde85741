"""A simulated patient in five views, beating, with what is true of the heart, as HTML."""

import io
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from PIL import Image

from racines_data.geometry import Pose
from racines_data.patients.patient import PATHOLOGIES
from racines_data.patients.splits import SPLITS, split_of
from racines_data.plotting import mark_depth
from racines_data.views import VIEW_TITLES, VIEWS
from racines_envs.task.names import BEATING
from racines_leaderboard.studio.html import animation, table
from racines_leaderboard.studio.parts import Place, Shared
from racines_leaderboard.studio.worlds import patient_of, ward_of

FRAMES = 16
"""Of a beat."""
ZOOM = 2
"""Times the image's size, so that the depth scale is sharp."""
TITLES = {
    "healthy": "healthy heart", "dilated": "dilated left ventricle",
    "hypertrophied": "hypertrophied left ventricle", "small": "small heart",
    "atria": "enlarged atria", "right": "dilated right ventricle",
}  # fmt: skip
"""Of the pathologies, in words."""
assert set(TITLES) == set(PATHOLOGIES)
_sheets: Shared["Sheet"] = Shared(32)


@dataclass(frozen=True)
class Sheet:
    """What the page shows of a patient."""

    seed: int
    split: str
    facts: tuple[tuple[str, str], ...]
    """Names and values, in words."""
    films: tuple[tuple[str, bytes], ...]
    """Views, and each as an animated WebP of one beat."""


def beside(value: Any, step: int) -> int:
    """Return the patient before (-1) or after (1) another in its split, round and round."""
    seed = patient_of(value)
    seeds = SPLITS[split_of(seed)]
    return seeds[(seeds.index(seed) + step) % len(seeds)]


def sheet(place: Place, value: Any) -> Sheet:
    """Return a patient's sheet, drawn now (a few seconds) or before."""
    seed = patient_of(value)
    return _sheets.get((seed, place.device), lambda: _draw(place, seed))


def _draw(place: Place, seed: int) -> Sheet:
    ward = ward_of(place, BEATING, seed)
    pool, heart = ward.pool, ward.pool.hearts[0]
    patient, beat = heart.patient, 60.0 / heart.patient.motion.rate
    rows = torch.zeros(FRAMES, dtype=torch.int64, device=pool.device)
    phase = torch.stack([torch.arange(FRAMES) / FRAMES, torch.zeros(FRAMES)], 1).double()
    poses, pixel = pool.targets(rows), float(pool.pixel_size(rows[:1])[0])
    films = []
    for view, name in enumerate(VIEWS):
        pose = Pose(*(part[:, view] for part in poses))
        images = pool.render(pose, rows, phase.to(pool.device), torch.arange(FRAMES)).cpu()
        films.append((name, film(images.numpy(), pixel, beat / FRAMES)))
    return Sheet(seed, split_of(seed), _facts(pool.measures(0), patient), tuple(films))


def _facts(measures: Any, patient: Any) -> tuple[tuple[str, str], ...]:
    body, motion = patient.body, patient.motion
    sex = "woman" if body.female else "man"
    return (
        ("Patient", f"{sex}, {100 * body.height:.0f} cm, {body.weight:.0f} kg"),
        ("Heart", TITLES[patient.pathology]),
        ("Ejection fraction", f"{100 * measures.ejection_fraction:.0f} %"),
        ("LV volume", f"{measures.volumes['lv'][0]:.0f} ml at end diastole, "
                      f"{measures.volumes['lv'][-1]:.0f} ml at end systole"),
        ("Heart rate", f"{motion.rate:.0f} a minute"
                       + (", with early beats" if motion.early else "")),
    )  # fmt: skip


def film(images: np.ndarray, pixel: float, seconds: float) -> bytes:
    """Return (T, H, W) uint8 images as an animated WebP with a depth scale; `pixel` in mm."""
    pictures = [_with_scale(image, pixel) for image in images]
    packed = io.BytesIO()
    pictures[0].save(
        packed, "WEBP", save_all=True, append_images=pictures[1:], loop=0,
        duration=max(20, round(1e3 * seconds)), quality=80, method=2,
    )  # fmt: skip
    return packed.getvalue()


def _with_scale(image: np.ndarray, pixel: float) -> Image.Image:
    """Return an image enlarged, with its depth in cm at the right."""
    height, width = (ZOOM * side for side in image.shape)
    large = Image.fromarray(image).resize((width, height), Image.Resampling.BICUBIC)
    mark_depth(large, pixel / ZOOM)
    return large


def html(shown: Sheet) -> str:
    """Return the films of a patient, a card each, and what is true of the heart."""
    cards = "".join(
        f'<figure class="rg-card">{animation(data, f"{VIEW_TITLES[name]} view, beating", "")}'
        f"<figcaption><b>{name}</b><span>{VIEW_TITLES[name]}</span></figcaption></figure>"
        for name, data in shown.films
    )
    rows = [(name, value) for name, value in shown.facts]
    head = (f"Patient {shown.seed}", f"{shown.split} split")
    facts = table(head, rows, ("rc-text", "rc-text"))
    return f'<div class="rc-films">{cards}</div>{facts}'
