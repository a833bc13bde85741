"""The contact sheet of patients: who is on it, and the colours of a mask."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from racines_data.card.contact_sheet import PATIENTS, STRENGTH, coloured, sheet_figure
from racines_data.card.frames import Frames
from racines_data.patients import LABELS
from racines_data.plotting import TISSUES
from racines_data.views import LABELS as VIEW_LABELS


@pytest.fixture(scope="module")
def frames() -> Frames:
    """Eight patients, a sweep each; a frame of every label, twice, the second with less grade."""
    count, labels = 8, len(VIEW_LABELS)
    views = np.tile(np.arange(labels), 2 * count)
    rows = np.arange(len(views))
    return Frames(
        images=np.broadcast_to((rows % 250).astype(np.uint8)[:, None, None], (len(rows), 128, 128)),
        parameters=np.zeros((len(rows), 12), np.float32),
        views=views,
        grades=np.where(rows // labels % 2, 5.0, 9.0).astype(np.float32),
        timestamps=rows.astype(float),
        trajectory=rows // (2 * labels),
        target_views=["A4C"] * count,
        phantoms=[None] * count,
        splits={"train": (0, len(rows))},
        labels=VIEW_LABELS,
        patients=list(range(1, count + 1)),
        masks=np.full((len(rows), 128, 128), LABELS.index("LV"), np.uint8),
    )


PEOPLE: list[dict[str, Any]] = [
    {"patient": number, "pathology": "healthy", "split": "train"} for number in range(1, 9)
]


def shown(figure: Any) -> list[int]:
    """The gray level of each picture, which is its row here; -1 where it has colours."""
    pictures = [image.get_array() for image in figure.axes[0].get_images()]
    return [int(each[0, 0]) if each.ndim == 2 else -1 for each in pictures]


def test_a_row_is_a_patient_in_the_best_frame_of_each_view(frames: Frames):
    figure = sheet_figure(frames, PEOPLE, LABELS)
    chosen = (0, 1, 3, 4, 6, 7)  # evenly, the first and the last among them
    expected = [[12 * who + view for view in range(5)] + [-1] for who in chosen]
    assert shown(figure) == sum(expected, []) and len(chosen) == PATIENTS
    names = [text.get_text() for text in figure.axes[0].texts]
    assert {"A4C", "A4C, mask", "8", "train\nhealthy", "LV"} <= set(names)


def test_a_view_that_no_frame_shows_is_said_to_be_none(frames: Frames):
    none = np.where(frames.views == 2, -1, frames.views)
    figure = sheet_figure(replace(frames, views=none, masks=None), PEOPLE[:2], ())
    assert shown(figure) == [0, 1, 3, 4, 12, 13, 15, 16]
    names = [text.get_text() for text in figure.axes[0].texts]
    assert names.count("not shown in\nany frame") == 2 and "A4C, mask" not in names


def test_a_mask_colours_what_it_names():
    image = np.full((2, 2), 100, np.uint8)
    mask = np.array([[0, LABELS.index("LV")], [LABELS.index("LA"), 0]], np.uint8)
    made = coloured(image, mask, LABELS)
    assert made.dtype == np.uint8 and (made[mask == 0] == 100).all()
    for label in ("LV", "LA"):
        wanted = 100 * (1 - STRENGTH) + 255 * STRENGTH * np.array(to_rgb(TISSUES[label]))
        assert np.abs(made[mask == LABELS.index(label)] - wanted).max() <= 0.5
    assert set(TISSUES) <= set(LABELS)
