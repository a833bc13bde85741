"""Reports as tables: for the terminal and as Markdown. A row a field, its gravest verdict told."""

from collections.abc import Iterator
from typing import Any

from racines_data.tables import console_table, escape, markdown_table
from racines_leaderboard.audit.verdicts import (
    FAILS,
    HOLDS,
    SKIPPED,
    UNKNOWN,
    Report,
    Verdict,
    gravest,
)

Row = tuple[str, str, str, str, str]
HEAD = ("Claim", "Verdict", "Why", "In the record", "Here")
MARKS = {FAILS: "bold red", UNKNOWN: "yellow", SKIPPED: "dim"}
SHOWN = 16
"""Characters of a digest, or digits of a number."""


def rows(report: Report) -> Iterator[Row]:
    """Give the rows of a report: one a metric that holds, one all that is open for one reason."""
    groups: dict[str, list[Verdict]] = {}
    for verdict in report.verdicts:
        groups.setdefault(_group(verdict.subject), []).append(verdict)
    alike: dict[tuple[str, str], list[str]] = {}
    for name, verdicts in groups.items():
        worst = gravest(verdicts)
        if worst == FAILS:
            for each in verdicts:
                if each.verdict == worst:
                    yield each.subject, worst, each.reason, _short(each.claimed), _short(each.found)
        elif worst == HOLDS:
            yield name, worst, _reasons(verdicts), *_numbers(verdicts)
        else:
            reason = next(each.reason for each in verdicts if each.verdict == worst)
            alike.setdefault((worst, reason), []).append(name)
    for (worst, reason), names in alike.items():
        yield _listed(names), worst, reason, "", ""


def _listed(names: list[str]) -> str:
    shown = ", ".join(names[:3])
    return shown if len(names) <= 3 else f"{shown} and {len(names) - 3} more"


def _group(subject: str) -> str:
    parts = subject.split(".")
    if parts[0] == "metrics":
        return ".".join(parts[:2])
    return "by_seed" if parts[0] == "by_seed" else subject


def _reasons(verdicts: list[Verdict]) -> str:
    """Return what is told of a metric that holds: how far off it was, where it was."""
    reasons = [verdict.reason for verdict in verdicts]
    recomputed = [reason for reason in reasons if reason.startswith("recomputed")]
    differing = [reason for reason in recomputed if "equal" not in reason]
    counted = f" ({len(reasons)} checks)" if len(reasons) > 1 else ""
    return (differing or recomputed or reasons)[0] + counted


def _numbers(verdicts: list[Verdict]) -> tuple[str, str]:
    values = [each for each in verdicts if each.subject.endswith(".value")]
    each = values[0] if values else verdicts[0]
    return (_short(each.claimed), _short(each.found)) if values or len(verdicts) == 1 else ("", "")


def _short(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.8g}"
    text = str(value)
    return text if len(text) <= 2 * SHOWN else f"{text[:SHOWN]}…"


def summary(report: Report) -> str:
    """Return one line: the record, what it comes to, and how its numbers were recomputed."""
    counts = [f"{report.count(v)} {v}" for v in (FAILS, UNKNOWN, SKIPPED) if report.count(v)]
    claims = f"{len(report.verdicts)} claims" + "".join(f", {each}" for each in counts)
    verdict = "holds" if report.holds else "DOES NOT HOLD"
    how = report.made_again
    again = f"; recomputed from {how['from']}, {how['agreement']}" if "agreement" in how else ""
    return f"{report.board}/{report.track}/{report.name}: {verdict} ({claims}{again})"


def show(report: Report, details: bool) -> None:
    """Print a report: all rows with `details`, else those that do not plainly hold."""
    from rich.console import Console
    from rich.text import Text

    console = Console()
    shown = [
        [Text(cell, MARKS.get(row[1], "")) for cell in row]
        for row in rows(report)
        if details or row[1] in MARKS
    ]
    console.print(summary(report), style=None if report.holds else "bold red", markup=False)
    if shown:
        console.print(console_table(HEAD, shown, right=None))


def audit_markdown(reports: list[Report]) -> str:
    """Return reports as a Markdown page."""
    parts = ["# Audit", "", "Research software, not a medical device.", ""]
    for report in reports:
        parts += [f"## {report.board}/{report.track}/{report.name}", "", escape(summary(report))]
        parts += ["", markdown_table(HEAD, rows(report)), ""]
    return "\n".join(parts)
