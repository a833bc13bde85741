"""The picture of a generator that adapts: what it was shown of patients, what is true, its own."""

from collections.abc import Mapping
from pathlib import Path

from torch import Tensor

from racines_data.card.pictures import place, sheet
from racines_data.files import write_atomic
from racines_data.patients.heart import make_heart
from racines_data.patients.population import draw_patient
from racines_data.patients.scouts import FRAMES, POSES, strata_names
from racines_data.plotting import INK, MUTED, SMALL, card_style, encode, show_depth
from racines_data.store.asked import AskedStore
from racines_models.sample import evenly

SHOWN, COLUMNS = 4, 8
"""Patients in the picture, and images of each in a row."""
EDGE, STEP, MARGIN, HEAD, GAP = 1.2, 1.23, 0.82, 0.42, 0.14
"""Inches: an image, from one to the next, the names aside, those above, between patients."""


def write_adapted(path: Path, asked: AskedStore, drawn: Mapping[str, Tensor]) -> None:
    """Write a PNG of some patients: frames of the scout, true frames near to far, and drawn ones.

    Args:
        path: to write.
        asked: patients, their scouts and the true frames.
        drawn: by the name of its row, (P · 32, 128, 128) uint8 in the order of `asked`.
    """
    some, patients = evenly(POSES, COLUMNS), (asked.patients or [])[:SHOWN]
    block = (2 + len(drawn)) * STEP + GAP
    height = HEAD + len(patients) * block
    with card_style():
        figure, axis = sheet(MARGIN + COLUMNS * STEP, height)
        middle = MARGIN + COLUMNS * STEP / 2
        told = "distance of the true and the drawn pose from the nearest frame of the scout"
        axis.text(middle, 0.15, told, size=SMALL, color=MUTED, ha="center", va="center")
        for column, stratum in enumerate(asked.strata[some].tolist()):
            left = MARGIN + column * STEP + EDGE / 2
            axis.text(left, HEAD - 0.05, strata_names()[stratum], ha="center", va="bottom")
        for number, patient in enumerate(patients):
            top = HEAD + number * block
            mm = float(make_heart(draw_patient(patient), beating=False).settings.pixel_size())
            frames = slice(number * POSES, (number + 1) * POSES)
            rows = {
                "scout": asked.scouts[number][evenly(FRAMES, COLUMNS)],
                "true": asked.images[frames][some],
                **{name: images[frames][some] for name, images in drawn.items()},
            }
            for line, (name, images) in enumerate(rows.items()):
                y = top + line * STEP
                if line == 0:
                    look = {"size": SMALL, "color": MUTED, "ha": "right", "va": "top"}
                    axis.text(MARGIN - 0.1, y + 0.02, f"patient\n{patient}", **look)
                axis.text(MARGIN - 0.1, y + EDGE / 2, name, color=INK, ha="right", va="center")
                for column, image in enumerate(images.numpy()):
                    place(axis, image, MARGIN + column * STEP, y, EDGE)
            show_depth(axis, EDGE, mm * asked.images.shape[-1] / EDGE, (MARGIN, top))
        png = encode(figure, gray=True)
    write_atomic(path, png)
