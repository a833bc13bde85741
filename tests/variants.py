"""Variants of a test: those that are run each time, and those for `make test-thorough`."""

from collections.abc import Iterable, Sequence
from itertools import product
from typing import Any

import pytest


def crossed(*axes: Sequence[Any], every: int = 3) -> list[Any]:
    """Return all combinations; each time run those whose places sum to a multiple of `every`.

    Of two axes each value is among them, if no axis is shorter than `every`; of three, each pair.
    """
    found = []
    for places in product(*(range(len(axis)) for axis in axes)):
        values = [axis[place] for axis, place in zip(axes, places, strict=True)]
        marks = () if sum(places) % every == 0 else (pytest.mark.thorough,)
        found.append(pytest.param(*values, marks=marks))
    return found


def first_of(values: Iterable[Any], often: int = 1) -> list[Any]:
    """Return all values; run each time are the first, `often` of them."""
    return [
        value if place < often else pytest.param(value, marks=pytest.mark.thorough)
        for place, value in enumerate(values)
    ]
