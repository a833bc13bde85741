"""The kinds of damage that an import of the published recordings names."""

from enum import StrEnum

from racines_data.sources.base import Finding


class Kind(StrEnum):
    """What is wrong; every reason in the report begins with one of these and a colon."""

    MISSING_LOG = "missing log"
    MISSING_IMAGE = "missing image"
    TRUNCATED_PNG = "truncated PNG"
    NOT_A_PNG = "not a PNG"
    DAMAGED_PNG = "damaged PNG"
    UNREADABLE_IMAGE = "unreadable image"
    MIXED_SIZES = "mixed sizes"
    UNREADABLE_LOG = "unreadable log"
    WRONG_SHAPE = "wrong matrix shape"
    NAN = "NaN"
    INFINITE = "infinite"
    REFLECTED = "reflected rotation"
    NOT_ORTHONORMAL = "non-orthonormal rotation"
    NOT_RIGID = "not a rigid pose"
    MILLIMETRES = "millimetres"
    METRES = "metres"
    OUT_OF_REACH = "out of reach"
    CLOCK = "clock"
    DUPLICATE_NUMBER = "duplicate number"
    GAP = "gap in numbers"
    EMPTY_FOLDER = "empty folder"
    UNKNOWN = "unknown file"


def refused(kind: Kind | str, file: str, detail: str, item: str = "", frames: int = 1) -> Finding:
    """Return a finding that costs frames."""
    return Finding(file, item, True, f"{kind}: {detail}", frames)


def flagged(kind: Kind | str, file: str, detail: str, item: str = "", frames: int = 1) -> Finding:
    """Return a finding about frames that are kept."""
    return Finding(file, item, False, f"{kind}: {detail}", frames)


def count_kinds(report: list[Finding]) -> dict[str, int]:
    """Return the number of findings of each kind, in order of first appearance."""
    counts: dict[str, int] = {}
    for finding in report:
        kind = finding.reason.partition(":")[0]
        counts[kind] = counts.get(kind, 0) + 1
    return counts
