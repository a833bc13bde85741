"""What a kit tells its raters."""

from collections.abc import Sequence
from typing import Any

from racines_data.views import VIEW_TITLES

INSTRUCTIONS = (
    "You will see ultrasound images one by one. Say of each which standard view it shows, or that "
    "it shows none. Then grade it from 1, poor, to 10, excellent, by two criteria: completeness, "
    "are the structures of the view in the image, and clarity, can they be told apart. An image of "
    "no view is graded 0. Judge each image by itself. Some come twice. An answer cannot be changed."
)
PREFACE = (
    "The images come from a simulated or artificial block, or from programs that imitate it. "
    "There may be no valves. Research software, not a medical device."
)


def described(labels: Sequence[str]) -> dict[str, Any]:
    """Return the part of a kit's document that is the same for all its images.

    `labels` are the view labels; the last says that there is no view.
    """
    return {
        "schema": "racines.expert-kit/1",
        "preface": PREFACE,
        "instructions": INSTRUCTIONS,
        "views": [{"name": name, "title": VIEW_TITLES.get(name, name)} for name in labels],
        "grades": {"no_view": 0, "lowest": 1, "highest": 10},
    }
