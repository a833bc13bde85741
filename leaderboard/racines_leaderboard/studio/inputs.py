"""What a browser sends, checked again on the server: a page's own limits bind only the honest.

What is at fault raises a `RacinesError` that begins with the name of its field.
"""

import math
from collections.abc import Collection
from typing import Any, TypeVar

from racines_data.errors import RacinesError

Option = TypeVar("Option")
GREATEST_SEED = 2**31 - 1
MARKS = frozenset(" .,;:()'/&+-_")
"""Beside letters and digits of any script, what a line of words may hold."""


def choice(value: Any, offered: Collection[Option], field: str) -> Option:
    """Return a value that was offered."""
    for option in offered:
        if type(option) is type(value) and option == value:
            return option
    raise RacinesError(f"{field}: {str(value)[:60]!r} was not offered")


def choices(values: Any, offered: Collection[Option], field: str) -> tuple[Option, ...]:
    """Return the offered options among which `values` lie, in the order in which they are offered.

    Anything but a list is refused, and so is a list with an entry that was not offered.
    """
    if not isinstance(values, list | tuple) or len(values) > len(offered):
        raise RacinesError(f"{field}: choose among what is offered")
    chosen = [choice(value, offered, field) for value in values]
    return tuple(option for option in offered if option in chosen)


def number(value: Any, low: float, high: float, field: str) -> float:
    """Return a finite number between two limits, both included."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise RacinesError(f"{field}: give a number from {low:g} to {high:g}")
    if not low <= value <= high:
        raise RacinesError(f"{field}: {value:g} is not between {low:g} and {high:g}")
    return float(value)


def whole(value: Any, low: int, high: int, field: str) -> int:
    """Return a whole number between two limits, both included."""
    if number(value, low, high, field) % 1:
        raise RacinesError(f"{field}: {value:g}: give a whole number")
    return int(value)


def words(value: Any, longest: int, field: str) -> str:
    """Return a line of letters, digits and `MARKS`, without spaces at its ends."""
    if not isinstance(value, str) or len(value) > longest:
        raise RacinesError(f"{field}: give at most {longest} characters")
    if wrong := sorted({c for c in value if not (c.isalnum() or c in MARKS)}):
        shown = " ".join(wrong[:5]) if all(map(str.isprintable, wrong)) else "invisible ones"
        raise RacinesError(f"{field}: letters, digits and {''.join(sorted(MARKS))}, not {shown}")
    return value.strip()
