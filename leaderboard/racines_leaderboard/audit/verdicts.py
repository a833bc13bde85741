"""What an audit finds: one verdict a claim, and the report of a record."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Any

HOLDS = "holds"
FAILS = "does not hold"
UNKNOWN = "cannot be checked"
SKIPPED = "not checked"
"""Left out by `--quick`."""
VERDICTS = (FAILS, UNKNOWN, SKIPPED, HOLDS)
"""The gravest first."""


@dataclass(frozen=True)
class Verdict:
    """One claim of a record, and whether it holds."""

    subject: str
    """The field: `weights.model.safetensors`, `metrics.fid.value`."""
    verdict: str
    reason: str
    claimed: Any = None
    found: Any = None
    tolerance: float | None = None
    """The largest difference that passes; None where values are equal or are not."""


@dataclass(frozen=True)
class Report:
    """All verdicts on one record."""

    board: str
    track: str
    name: str
    tier: str
    """The tier that the record says it has."""
    verdicts: tuple[Verdict, ...]
    made_again: dict[str, Any] = field(default_factory=dict)
    """How the numbers were recomputed: `road`, `agreement`; empty where they were not."""

    @property
    def holds(self) -> bool:
        """Whether nothing fails to hold."""
        return not self.count(FAILS)

    def count(self, verdict: str) -> int:
        """Return how many claims have a verdict."""
        return sum(each.verdict == verdict for each in self.verdicts)

    def to_json(self) -> dict[str, Any]:
        """Return the report as `--json` prints it."""
        counts = {verdict: self.count(verdict) for verdict in VERDICTS}
        return asdict(self) | {"holds": self.holds, "counts": counts}


def holds(subject: str, reason: str, claimed: Any = None, found: Any = None) -> Verdict:
    """Say that a claim holds."""
    return Verdict(subject, HOLDS, reason, claimed, found)


def fails(subject: str, reason: str, claimed: Any = None, found: Any = None) -> Verdict:
    """Say that a claim does not hold."""
    return Verdict(subject, FAILS, reason, claimed, found)


def unknown(subject: str, reason: str, claimed: Any = None, found: Any = None) -> Verdict:
    """Say that a claim cannot be checked."""
    return Verdict(subject, UNKNOWN, reason, claimed, found)


def equal(subject: str, claimed: Any, found: Any, reason: str) -> Verdict:
    """Hold a claim against what was found; `reason` says where."""
    say = holds if claimed == found else fails
    return say(subject, reason, claimed, found)


def gravest(verdicts: Iterable[Verdict]) -> str:
    """Return the gravest of some verdicts."""
    present = {verdict.verdict for verdict in verdicts}
    return next(verdict for verdict in VERDICTS if verdict in present)
