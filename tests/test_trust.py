"""The page of attacks: each names a test that is there."""

import re
from pathlib import Path

from tests.modules import ROOT

PAGE = ROOT / "docs/trust.md"
NAMED = re.compile(r"((?:tests/)?(?:\w+/)*test_\w+\.py)?::(\w+)")


def rows() -> list[str]:
    """Return the rows of the page's tables but for their heads."""
    lines = PAGE.read_text().splitlines()
    return [
        line for line in lines if line.startswith("|") and not re.match(r"\| (attack|---)", line)
    ]


def test_every_attack_names_a_test_that_is_there():
    """A row may say `…::name` or `::name` of the file that was named last."""
    file, missing = Path(), []
    for row in rows():
        named = NAMED.findall(row.rsplit(" | ", 1)[-1])
        if not named:
            missing.append(row)
        for path, test in named:
            if path:
                file = ROOT / path if path.startswith("tests/") else file.with_name(path)
            if not re.search(rf"(?:def|class) {test}\b", file.read_text()):
                missing.append(f"{file.name}::{test}")
    assert not missing
    assert len(rows()) >= 200
