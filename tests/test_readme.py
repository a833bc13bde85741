"""What the README says is run: each Python block, then each bash block, on a tiny dataset."""

import re
import subprocess
from pathlib import Path

import pytest

from racines_leaderboard.board.collect import boards
from racines_leaderboard.board.pages import BEGIN, END, with_tables
from tests.conftest import ROOT, command
from tests.documents import blocks, command_lines, run_line

pytestmark = [pytest.mark.docs, pytest.mark.usefixtures("drawn_pictures")]
README = ROOT / "README.md"
ONE_HEART = ROOT / "docs/one-heart.md"
"""Has the tables of the default board."""


@pytest.mark.slow
def test_the_code_blocks_run_in_order(workplace: Path):
    """Set up as the README has it by then: a dataset and a grader, here tiny ones."""
    command(workplace, "racines", "train", "grader")
    ran = 0
    for block in blocks(README):
        if block.language == "python" and block.text.startswith("# "):
            (workplace / block.text.split()[1]).write_text(block.text)
        elif block.language == "python":
            command(workplace, "python", "-c", block.text)
        elif block.language == "bash":
            for line in command_lines(block.text):
                run_line(line, workplace, command)
        else:
            continue
        ran += 1
    assert ran >= 4
    scores = workplace / "my-scores" / "median-image.json"
    assert scores.exists() and list((workplace / "leaderboard").rglob("median-image.json"))


def test_the_links_hold():
    for target in re.findall(r"\]\(([^)#:]+)\)", README.read_text()):
        assert (ROOT / target).exists(), target


def test_the_figures_are_those_of_the_committed_results():
    """Only where neither has been touched: a run of one's own may differ in the last digits."""
    paths = (str(ONE_HEART), "leaderboard/results")
    clean = subprocess.run(["git", "diff", "--quiet", "HEAD", "--", *paths], cwd=ROOT).returncode
    results = ROOT / "leaderboard" / "results"
    text = ONE_HEART.read_text()
    begin = BEGIN.format(board="phantom-default")
    if "phantom-default" not in boards(results):
        assert f"{begin}\n{END}" in text, "no results, no figures"
    elif clean == 0:
        assert with_tables(text, results, ONE_HEART.name) == text
    else:
        assert begin in text


def test_it_can_be_read_at_a_sitting():
    assert len(README.read_text().splitlines()) <= 150
