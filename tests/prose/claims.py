"""Numbers in prose that say how much, and that no marker stands around."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import yaml

from tests.prose.markers import ASSERTION, MARKER

ALLOWED = Path(__file__).with_name("allowed.yaml")
REASONS = {
    "constant": "a setting, limit, size or default: the code says it, and refuses what differs",
    "test": "a bound or count that a named test holds",
    "cited": "of the paper, a norm or other literature",
    "computed": "arithmetic on the page, or run by a block of it",
    "written": "written by a command and compared by a test of its own",
}
"""Why a number may stand without a marker."""
UNIT = (
    r"%|[mcµ]m\b|dB\b|°|degrees?\b|ms\b|µs\b|s\b|h\b|min\b|minutes?\b|seconds\b|hours?\b|[kMG]i?B\b"
    r"|N\b|gray levels?\b|levels?\b|images/s\b|steps/s\b|times\b|GHz\b|pixels\b|million\b"
    r"|tests\b|lines\b|attacks\b|changes\b|(?:system )?calls\b|commands\b|agents\b"
    r"|generators\b|numbers\b|metrics\b|of (?:the )?\d[\d,]*\b"
)
CLAIM = re.compile(
    rf"(?<![\w.#/-])[-−+]?\d[\d,]*(?:\.\d+)?(?:e-?\d+)?"
    rf"(?:\s?(?:–|to|and|or|,|;)\s?[-−+]?\d[\d,]*(?:\.\d+)?)*\s?(?:{UNIT})"
    r"|(?<![\w.#/-])[-−+]?\d[\d,]*\.\d+(?![\w.])"
)
"""A number with a unit, alone or with others, or one with decimals."""
HIDDEN = re.compile(
    r"^```.*?^```[^\n]*$|^(?: {4}|\t)[^\n]*$|``.+?``|`[^`]*`|<!--.*?-->|\]\([^)]*\)|https?://\S+"
    r"|\bDOI 10\.\S+"
    r"|\b\d+\.\d+\.\d+\S*|95 % (?:bootstrap )?intervals?|\b(?:Python|CC BY|Croissant|RAI) \d\S*",
    re.MULTILINE | re.DOTALL,
)
"""Code, comments, addresses, versions, and names that have a number."""
BOARDS = re.compile(r"<!-- leaderboard .*?<!-- end of leaderboard -->", re.DOTALL)


@dataclass(frozen=True)
class Claim:
    """A number with its place on a page."""

    line: int
    text: str
    context: str


def _blank(found: re.Match[str]) -> str:
    return re.sub(r"[^\n]", "\0", found[0])


@cache
def _parsed(text: str) -> dict[str, dict[str, list[str]]]:
    return yaml.safe_load(text)


def _allowed(page: str) -> list[tuple[str, str]]:
    """Return reason and text of what may stand on a page without a marker."""
    entries = _parsed(ALLOWED.read_text()).get(page) or {}
    return [(reason, text) for reason, texts in entries.items() for text in texts]


def _phrase(text: str) -> re.Pattern[str]:
    if text.startswith("## "):  # a section
        return re.compile(rf"^{re.escape(text)}\n.*?(?=^## |\Z)", re.MULTILINE | re.DOTALL)
    return re.compile(r"(?<![\w.,])" + r"\s+".join(map(re.escape, text.split())) + r"(?![\w%])")


def claims(text: str) -> list[Claim]:
    """Return the numbers of a page that say how much, and have no marker."""
    return list(_found(_read(text), text))


def _read(text: str) -> str:
    for pattern in (BOARDS, MARKER, ASSERTION, HIDDEN):
        text = pattern.sub(_blank, text)
    return text


def _found(readable: str, text: str) -> Iterator[Claim]:
    for found in CLAIM.finditer(readable):
        start = text.rfind("\n", 0, found.start()) + 1
        end = text.find("\n", found.end())
        line = text.count("\n", 0, found.start()) + 1
        yield Claim(line, " ".join(found[0].split()), text[start : end if end > 0 else None])


def unmarked(name: str, text: str) -> tuple[list[Claim], list[str]]:
    """Return the claims that are neither marked nor allowed, and what is allowed in vain."""
    readable, stale = _read(text), []
    for reason, phrase in _allowed(name):
        if reason not in REASONS:
            stale.append(f"{name}: no reason {reason!r}; there are {', '.join(REASONS)}")
        if phrase == "*":  # the whole page
            return [], stale
        places = list(_phrase(phrase).finditer(text))
        if not places:
            stale.append(f"{name}: no longer on the page: {phrase!r}")
        for place in places:
            readable = readable[: place.start()] + _blank(place) + readable[place.end() :]
    return list(_found(readable, text)), stale
