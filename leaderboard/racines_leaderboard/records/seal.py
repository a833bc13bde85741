"""A record's seal: the sha256 of what it says, written when the record is.

A seal notices that a record was edited, or damaged, after it was written. Whoever edits a record
can seal it again; that is noticed by recomputing the numbers alone (`racines audit`).
"""

import hashlib
from typing import Any

from racines_data.digest import canonical_json

KEY = "seal"


def seal_of(record: dict[str, Any]) -> str:
    """Return the sha256 of a record but for its seal; neither order nor spaces count."""
    told = {key: value for key, value in record.items() if key != KEY}
    return hashlib.sha256(canonical_json(told).encode()).hexdigest()


def sealed(record: dict[str, Any]) -> dict[str, Any]:
    """Return a record with the seal of what it says."""
    return {key: value for key, value in record.items() if key != KEY} | {KEY: seal_of(record)}
