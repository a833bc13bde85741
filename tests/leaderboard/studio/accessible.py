"""What is asked of every page in a browser: axe finds nothing, nothing is wider than the window."""

from dataclasses import dataclass
from typing import Any

SIZES = [(1280, 900), (390, 844)]
"""Windows, pixels: a desk's and a phone's."""
TAGS = ("wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa")
"""Of axe's rules: WCAG 2.2, levels A and AA."""
ASKED_TOO = ("target-size", "empty-table-header")
"""Rules that are off unless they are named."""
LOADING = ".pending, [data-testid=status-tracker]:not(.hide)"
"""What Gradio lays over a part that waits for its answer, and pales meanwhile."""


@dataclass(frozen=True)
class Declared:
    """A finding that stays, since it lies in what others made."""

    rule: str
    where: str
    """Part of the selector that axe gives."""
    why: str


DECLARED: tuple[Declared, ...] = ()


def settle(page: Any) -> None:
    """Return once no part of a Studio is loading."""
    # What was clicked is sent a little later: until then nothing is loading yet.
    page.wait_for_timeout(300)
    page.wait_for_function(f"!document.querySelector('{LOADING}')")


def findings(page: Any) -> list[str]:
    """Return what axe finds and is not declared: rule, element and why."""
    from axe_playwright_python.sync_playwright import Axe

    rules = {name: {"enabled": True} for name in ASKED_TOO}
    options = {"runOnly": {"type": "tag", "values": TAGS}, "rules": rules}
    found = Axe().run(page, options=options | {"resultTypes": ["violations"]}).response
    ran = {each["id"] for kind in ("violations", "passes", "incomplete") for each in found[kind]}
    assert {"color-contrast", "target-size"} <= ran
    return [
        f"{rule['id']}: {target} {_told(node)}"
        for rule in found["violations"]
        for node in rule["nodes"]
        for target in [" ".join(map(str, node["target"]))]
        if not any(rule["id"] == known.rule and known.where in target for known in DECLARED)
    ]


def _told(node: dict[str, Any]) -> str:
    checks = [*node["any"], *node["all"], *node["none"]]
    return checks[0]["message"] if checks else node["html"][:200]


def check(page: Any) -> None:
    """Ask of a page what is asked of all."""
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), "cut off"
    found = findings(page)
    assert not found, "\n".join(found)
