"""The page of an episode: one HTML file with its pictures and its player inside."""

import base64
import io
from importlib.resources import files
from string import Template
from typing import Any

from PIL import Image

from racines_data.escape import json_in_html
from racines_data.views import LABELS, VIEW_TITLES
from racines_envs.demo.chestmap import ChestMap
from racines_envs.demo.episode import Outcome, verdict
from racines_envs.demo.film import kept, ultrasound
from racines_envs.task.tiers import STEP_SECONDS

SEEN, QUALITY, EVERY = 384, 72, 2
"""Pixels of the pictures, how well they are packed, and steps from one to the next."""
AILING = {
    "healthy": "a healthy heart", "dilated": "a dilated left ventricle",
    "hypertrophied": "a thickened left ventricle", "small": "a small heart",
    "atria": "enlarged atria", "right": "a dilated right ventricle",
}  # fmt: skip


def page(outcome: Outcome, chest: ChestMap, next_commands: list[tuple[str, str]]) -> str:
    """Return the HTML; `next_commands` are commands, and what each does."""
    text = files("racines_envs.demo").joinpath("page.html").read_text(encoding="utf-8")
    content = json_in_html(_content(outcome, chest, next_commands))
    return Template(text).substitute(content=content)


def _content(
    outcome: Outcome, chest: ChestMap, next_commands: list[tuple[str, str]]
) -> dict[str, Any]:
    draw, shots, patient = outcome.draw, outcome.shots, outcome.heart.patient
    head, text = verdict(outcome)
    who = "woman" if patient.body.female else "man"
    ailing = AILING.get(patient.pathology, patient.pathology)
    beats = "beating" if draw.tier == "beating" else "still"
    frames = []
    for shot in kept(shots, EVERY):
        last = shot is shots[-1]
        frames.append({
            "step": shot.step, "distance": round(shot.distance, 1),
            "believed": round(shot.believed, 1), "spread": round(shot.spread, 1),
            "read": round(max(shot.read, 0.0), 1), "grade": round(shot.grade, 1),
            "view": LABELS[shot.view], "title": VIEW_TITLES[LABELS[shot.view]],
            "seen": _packed(ultrasound(shot.image, SEEN, pixel=outcome.pixel)),
            "map": _packed(chest.picture(shots, shot, draw.view, last)),
        })  # fmt: skip
    return {
        "found": outcome.found, "head": head, "text": text, "view": draw.view,
        "title": VIEW_TITLES[draw.view], "seconds": STEP_SECONDS,
        "who": f"Simulated patient {draw.patient} of the test split: a {who} with {ailing}, "
        f"{beats}. The agent has never scanned this patient.",
        "again": draw.again, "frames": frames,
        "declared": outcome.declared,
        "last": _packed(ultrasound(shots[-1].image, SEEN, outcome.names[0], outcome.pixel)),
        "best": _packed(ultrasound(outcome.own_image, SEEN, outcome.names[1], outcome.pixel)),
        "next": [{"command": command, "about": about} for command, about in next_commands],
    }  # fmt: skip


def _packed(image: Image.Image) -> str:
    """Return a picture as a data URL."""
    buffer = io.BytesIO()
    image.save(buffer, "WEBP", quality=QUALITY, method=2)
    return "data:image/webp;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
