"""What an audit finds: one verdict a claim, and the report of a record with its tables.

A record *does not hold* if one of its claims does not. It *holds* if its numbers were recomputed
and nothing is open on which a rank, a tier or the verdict rests; otherwise it is *not verified*.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from rich.text import Text

from racines_data.errors import RacinesError
from racines_data.tables import console_table, escape, markdown_table
from racines_data.terminal import console
from racines_leaderboard.records.schema import read_json, seal_of
from racines_leaderboard.records.tracks import TRACK
from racines_leaderboard.records.verdicts import DOES_NOT_HOLD, NOT_VERIFIED, Audited
from racines_leaderboard.records.verdicts import HOLDS as WHOLE_HOLDS

HOLDS = "holds"
FAILS = "does not hold"
UNKNOWN = "cannot be checked"
SKIPPED = "not checked"
"""Left out by `--quick`."""
TOLD = "informative"
"""Nothing rests on it: see `leaves.INFORMATIVE`."""
RETRAINABLE = "retrainable"
"""Not here, and all that is needed to make it anew is."""
VERDICTS = (FAILS, UNKNOWN, SKIPPED, RETRAINABLE, TOLD, HOLDS)
"""The gravest first."""
HEAD = ("Claim", "Verdict", "Why", "In the record", "Here")
MARKS = {FAILS: "bold red", UNKNOWN: "yellow", RETRAINABLE: "cyan", SKIPPED: "dim"}
DIFFERS = "differs by"
"""How the reason of a verdict on two numbers begins that are not equal to the last bit."""
SHOWN = 16
"""Characters of a digest."""


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


def _say(kind: str, subject: str, reason: str, claimed: Any = None, found: Any = None) -> Verdict:
    return Verdict(subject, kind, reason, claimed, found)


holds, fails, unknown, told = (partial(_say, kind) for kind in (HOLDS, FAILS, UNKNOWN, TOLD))
"""Say of a subject that its claim holds, does not, cannot be checked, or need not be, and why."""


def tell(right: bool, subject: str, reason: str, claimed: Any = None, found: Any = None) -> Verdict:
    """Say whether a claim holds."""
    return _say(HOLDS if right else FAILS, subject, reason, claimed, found)


def equal(subject: str, claimed: Any, found: Any, reason: str) -> Verdict:
    """Hold a claim against what was found; `reason` says where."""
    return tell(claimed == found, subject, reason, claimed, found)


@dataclass(frozen=True)
class Report:
    """All verdicts on one record."""

    board: str
    track: str
    name: str
    tier: str
    """The tier that the evidence here gives it."""
    verdicts: tuple[Verdict, ...]
    made_again: dict[str, Any] = field(default_factory=dict)
    """How the numbers were recomputed: `road`, `agreement`; empty where they were not."""
    remedies: tuple[str, ...] = ()
    """The commands that would verify what could not be."""

    @property
    def verdict(self) -> str:
        """What the record comes to: `does not hold`, `not verified` or `holds`."""
        if self.count(FAILS):
            return DOES_NOT_HOLD
        recomputed = "agreement" in self.made_again
        return NOT_VERIFIED if self.open or not recomputed else WHOLE_HOLDS

    @property
    def open(self) -> list[Verdict]:
        """What could not be checked and a rank, a tier or the verdict rests on."""
        return [
            each
            for each in self.verdicts
            if each.verdict in (UNKNOWN, SKIPPED) and self._counts(each.subject)
        ]

    def _counts(self, subject: str) -> bool:
        """Return whether something rests on a subject: on all but metrics that do not rank."""
        place, _, rest = subject.partition(".")
        if place not in ("metrics", "by_seed", "evidence"):
            return True
        # A figure of one seed has the seed before its name.
        name = rest.split(".")[1 if place == "by_seed" else 0] if rest else ""
        return not name or name in TRACK[self.track].ranked_by

    @property
    def holds(self) -> bool:
        """Whether all that counts was recomputed and holds."""
        return self.verdict == WHOLE_HOLDS

    @property
    def fails(self) -> bool:
        """Whether a claim does not hold."""
        return self.verdict == DOES_NOT_HOLD

    def count(self, verdict: str) -> int:
        """Return how many claims have a verdict."""
        return sum(each.verdict == verdict for each in self.verdicts)

    def to_json(self) -> dict[str, Any]:
        """Return the report as `--json` prints it."""
        counts = {verdict: self.count(verdict) for verdict in VERDICTS}
        whole = {"verdict": self.verdict, "holds": self.holds, "counts": counts}
        return asdict(self) | {"remedies": list(self.remedies)} | whole

    def summary(self) -> str:
        """Return one line: the record, what it comes to, and how its numbers were recomputed."""
        shown = (FAILS, UNKNOWN, SKIPPED, RETRAINABLE)
        counts = [f"{self.count(v)} {v}" for v in shown if self.count(v)]
        claims = ", ".join([f"{len(self.verdicts)} claims", *counts])
        verdict, how = self.verdict, self.made_again
        verdict = verdict if self.holds else verdict.upper()
        again = f"; recomputed from {how['from']}, {how['agreement']}" if "agreement" in how else ""
        return f"{self.board}/{self.track}/{self.name}: {verdict} ({claims}{again})"

    def rows(self) -> Iterator[tuple[str, str, str, str, str]]:
        """Give a row a metric that holds, a claim that fails, a reason that leaves some open."""
        groups: dict[str, list[Verdict]] = {}
        for verdict in self.verdicts:
            first, _, rest = verdict.subject.partition(".")
            metric = f"metrics.{rest.partition('.')[0]}"
            name = {"metrics": metric, "by_seed": first}.get(first, verdict.subject)
            groups.setdefault(name, []).append(verdict)
        alike: dict[tuple[str, str], list[str]] = {}
        for name, verdicts in groups.items():
            worst = min((each.verdict for each in verdicts), key=VERDICTS.index)
            those = [each for each in verdicts if each.verdict == worst]
            if worst == FAILS:
                for each in those:
                    yield each.subject, worst, each.reason, _short(each.claimed), _short(each.found)
            elif worst == HOLDS:
                yield name, worst, *_told(verdicts)
            else:
                alike.setdefault((worst, those[0].reason), []).append(name)
        for (worst, reason), names in alike.items():
            more = f" and {len(names) - 3} more" if len(names) > 3 else ""
            yield ", ".join(names[:3]) + more, worst, reason, "", ""


def kept_of(reports: list[Report], results: Path) -> dict[str, Audited]:
    """Return what is kept of each report by `track/name`, with the digest of its record."""
    kept = {}
    for each in reports:
        name = f"{each.track}/{each.name}"
        # A record that cannot be read has no digest; that it is refused needs no keeping.
        with contextlib.suppress(RacinesError):
            record = read_json(results / each.board / f"{name}.json", "record")
            agreement = each.made_again.get("agreement")
            trainings = [v.claimed for v in each.verdicts if v.verdict == RETRAINABLE]
            further = trainings[0] - 1 if trainings else 0
            kept[name] = Audited(each.verdict, seal_of(record), each.tier, agreement, further)
    return kept


def _told(verdicts: list[Verdict]) -> tuple[str, str, str]:
    """Return of what holds how far off it was, where it was, and the values there and here."""
    reasons = [verdict.reason for verdict in verdicts]
    recomputed = [reason for reason in reasons if reason.startswith("recomputed")]
    differing = [reason for reason in recomputed if "equal" not in reason]
    counted = f" ({len(reasons)} checks)" if len(reasons) > 1 else ""
    why = (differing or recomputed or reasons)[0] + counted
    values = [each for each in verdicts if each.subject.endswith(".value")]
    if not values and len(verdicts) > 1:
        return why, "", ""
    each = (values or verdicts)[0]
    return why, _short(each.claimed), _short(each.found)


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.8g}"
    text = "" if value is None else str(value)
    return text if len(text) <= 2 * SHOWN else f"{text[:SHOWN]}…"


def show(report: Report, details: bool) -> None:
    """Print a report: all rows with `details`, else those that do not plainly hold."""
    shown_on = console()
    shown = [
        [Text(cell, MARKS.get(row[1], "")) for cell in row]
        for row in report.rows()
        if details or row[1] in MARKS
    ]
    style = "bold red" if report.fails else None if report.holds else "yellow"
    shown_on.print(report.summary(), style=style)
    for command in report.remedies:
        shown_on.print(Text(f"  to verify: {command}"))
    if shown:
        shown_on.print(console_table(HEAD, shown, right=None))


def audit_markdown(reports: list[Report]) -> str:
    """Return reports as a Markdown page."""
    parts = ["# Audit", "", "Research software, not a medical device.", ""]
    for each in reports:
        where = escape(f"{each.board}/{each.track}/{each.name}")
        parts += [f"## {where}", "", escape(each.summary())]
        if each.remedies:
            parts += ["", "To verify:", "", *(f"    {command}" for command in each.remedies)]
        parts += ["", markdown_table(HEAD, each.rows()), ""]
    return "\n".join(parts)
