"""The documentation builds without a warning; its code runs, and its commands are commands."""

import os
import re
import shlex
import subprocess
import sys
import tomllib

import pytest
import typer.main
import yaml

from racines_leaderboard.cli.command import app
from tests.conftest import ROOT, command
from tests.documents import blocks, command_lines, run_page

pytestmark = [pytest.mark.docs, pytest.mark.usefixtures("drawn_pictures")]
PAGES = sorted((ROOT / "docs").glob("*.md"))
GUIDES = [page for page in PAGES if not page.name.startswith("walk-")]
"""Pages on a dataset that is there; the walk-throughs start from nothing: see test_walks.py."""
LONG = {
    "agents.md",
    "audit.md",
    "own-anatomy.md",
    "patients.md",
    "scores.md",
    "submit.md",
    "table.md",
}
"""Those whose blocks score or bake for longer than others: `.ci/run` leaves them to each week."""
NAMES = [page.name for page in PAGES]
LOADED = re.compile(r'<(?:script|img|iframe|source|link)\b[^>]*(?:src|href)="(https?:)?//[^"]*"')
DIAGRAM = re.compile(r'class="mermaid"')
"""What would make the theme fetch a library of another host."""
SOURCE = re.compile(r'href="(?!https?:)[^"#]+\.(?:md|ipynb)[#"]')
"""A link to a page's source, which is not on the site."""


@pytest.mark.slow
def test_pages_build_and_their_links_hold_and_load_nothing_from_elsewhere(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-d", str(tmp_path)],
        cwd=ROOT,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    built = {page.name: page.read_text() for page in tmp_path.glob("*.html")}
    shown = {page.name: page.read_text() for page in tmp_path.glob("notebooks/*.html")}
    assert {page.with_suffix(".html").name for page in PAGES} <= set(built)
    assert {f"{page.stem}.html" for page in (ROOT / "docs/notebooks").glob("*.ipynb")} == set(shown)
    for name, text in (built | shown).items():
        assert not LOADED.search(text) and not DIAGRAM.search(text), name
        assert "Research software, not a medical device" in text, name
        assert not SOURCE.findall(text), name
    assert 'id="racines_data.store.frames.FrameStore.batches"' in built["reference-data.html"]


def test_every_page_that_a_clinician_could_open_first_says_what_it_is_not():
    for page in (ROOT / "README.md", ROOT / "docs/index.md", ROOT / "leaderboard/README.md"):
        assert "not a medical device" in page.read_text(), page.name


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_every_block_is_run_or_read_or_says_why_not(page):
    fences = re.findall(r"^```", page.read_text(), re.MULTILINE)
    found = blocks(page)
    assert len(fences) == 2 * len(found), "a block without a language"
    for block in found:
        if block.language == "yaml":
            assert isinstance(yaml.safe_load(block.text), dict)
        elif block.language == "toml":
            assert tomllib.loads(block.text)
        else:
            assert block.language in ("python", "bash", "text"), block


@pytest.mark.parametrize("page", [*PAGES, ROOT / "README.md"], ids=[*NAMES, "README.md"])
def test_every_racines_command_takes_the_words_it_is_given(page):
    """Those that stand indented or in a block, whether they are run or not."""
    for line in command_lines(page.read_text()):
        if re.match(r"(?: {4})?racines [^`|]*$", line):
            parse(shlex.split(line.replace("[", " ").replace("]", " "), comments=True)[1:])


def parse(words: list[str]) -> None:
    """Refuse words that `racines` does not take."""
    found, told = typer.main.get_command(app), list(words)
    while hasattr(found, "commands"):
        if words[0] in {option for each in found.params for option in each.opts}:
            words.pop(0)  # a switch of the whole program
            if not words:
                return  # such as --install-completion, which is all of the line
        found = found.commands[words.pop(0)]
    try:
        found.make_context("racines", words)
    except Exception as error:
        raise AssertionError(f"racines {' '.join(told)}: {error}") from error


def test_long_pages_are_pages():
    assert set(NAMES) >= LONG


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=page.name, marks=[pytest.mark.thorough] * (page.name in LONG))
        for page in GUIDES
    ],
)
def test_code_blocks_run(page, workplace):
    run_page(page, workplace, command)
