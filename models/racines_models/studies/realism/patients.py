"""Two halves of the real patients: one to look at while the simulator is tuned, one to report on.

The lists in `patients.json` are written once, by a rule that nobody chose by what it gives, and a
test holds them to it. Whoever has tuned by a patient's frames has no figure of that patient.
"""

import hashlib
import json
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

from racines_data.errors import RacinesError

FILE = Path(__file__).with_name("patients.json")
LISTS = ("tuning", "reporting")
UNLISTED = "unlisted"
"""Patients of neither list: nobody said whether they were looked at."""


def halve(patients: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Split patients by the SHA-256 of their id: the lower half is for tuning."""
    order = sorted(set(patients), key=lambda each: hashlib.sha256(each.encode()).hexdigest())
    half = len(order) // 2
    return dict(zip(LISTS, (tuple(sorted(order[:half])), tuple(sorted(order[half:]))), strict=True))


@lru_cache(maxsize=1)
def patient_lists() -> dict[str, tuple[str, ...]]:
    """Return the ids of the committed lists."""
    content = json.loads(FILE.read_text(encoding="utf-8"))
    return {name: tuple(content[name]) for name in LISTS}


def patients_of(name: str) -> frozenset[str]:
    """Return the ids of a list.

    Raises:
        RacinesError: no list of that name.
    """
    if name not in LISTS:
        raise RacinesError(f"patients {name!r}: no such list; choose {' or '.join(LISTS)}")
    return frozenset(patient_lists()[name])


def list_of(patient: str) -> str:
    """Return the name of the list that a patient is in."""
    for name in LISTS:
        if patient in patients_of(name):
            return name
    return UNLISTED
