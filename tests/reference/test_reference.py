"""The pages of commands and settings are those of the code, and leave nothing out."""

import ast
import re
from pathlib import Path

import pytest
import yaml

from racines_data.config import PROFILES
from racines_leaderboard.cli.command import COMMANDS
from racines_leaderboard.cli.examples import EXIT_CODES
from tests.conftest import ROOT
from tests.reference import PAGES, commands, settings
from tests.test_output import FILES


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_of_todays_code(name: str):
    drawn = (ROOT / "docs" / name).read_text()
    assert drawn == PAGES[name](), f"docs/{name} is stale: python -m tests.reference"


def test_every_command_and_every_exit_code_is_there():
    page = commands.page()
    assert all(f"### `racines {words}`\n" in page for words in COMMANDS)
    assert all(f"| `{code}` | {told} |" in page for code, told in EXIT_CODES.items())
    assert page.count("\n### ") == len(COMMANDS)


def test_of_every_field_something_is_said():
    assert settings.undescribed() == []


def test_every_section_that_a_command_fills_is_there():
    """The names that `section` and `fill` are called with, and all of the packaged profiles."""
    told = {name.removesuffix(".NAME").partition(".")[0] for name in settings.SECTIONS}
    found = {name for path in FILES for name in _sections(path)}
    for profile in PROFILES:
        text = (ROOT / f"racines_data/profiles/{profile}.yaml").read_text()
        found |= set(yaml.safe_load(text)) - {"seed", "board", "patient_boards"}
    assert {"grader", "scores", "evaluation"} <= found
    assert found - told == set()


def _sections(path: Path) -> set[str]:
    """Return the first word of each section that a module reads by its name."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "section":
            name = node.args[1] if len(node.args) > 1 else None
            if isinstance(name, ast.Constant) and isinstance(name.value, str):
                found.add(name.value.partition(".")[0])
    return found


@pytest.mark.parametrize(
    ("field", "row"),
    [
        ("frames", r"\| `frames` \| integer \| `6000` \| Frames to acquire"),
        ("probe", r"\| `phantom\.probe\.depth` \| number \| `0\.155` \| Imaging depth, m\. \|"),
        ("also", r"\| `also` \| list of text \| `\[\]` \|"),
    ],
)
def test_a_field_has_type_default_and_unit(field: str, row: str):
    assert re.search(row, settings.page()), field
