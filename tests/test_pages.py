"""Pages of the documentation: each says first what it is for, and all are found from the index."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.conftest import ROOT

DOCS = ROOT / "docs"
PROSE = re.compile(r"[A-Z`*\[].*[a-z]")
"""How a paragraph begins; no code, table, picture, heading or list does."""


def pages() -> list[str]:
    """Return the pages of the menu."""
    menu = (ROOT / "mkdocs.yml").read_text().split("\nnav:\n")[1]
    return list(leaves(yaml.safe_load(menu)))


def leaves(node: Any) -> Iterator[str]:
    """Yield the pages below a part of the menu."""
    if isinstance(node, str):
        yield node
        return
    for child in node.values() if isinstance(node, dict) else node:
        yield from leaves(child)


WRITTEN = [page for page in pages() if Path(page).suffix == ".md"]


@pytest.mark.parametrize("page", WRITTEN)
def test_a_page_says_first_what_it_is_for(page: str):
    title, first, *_ = (
        line
        for line in (DOCS / page).read_text().splitlines()
        if line and not line.startswith("<!--")
    )
    assert title.startswith("# ")
    assert PROSE.match(first), f"{page} begins with {first!r}: say in a sentence what it is for"


def test_the_index_leads_to_every_page():
    index = (DOCS / "index.md").read_text()
    assert [page for page in pages() if page != "index.md" and f"({page}" not in index] == []
