"""`--quiet` and `--json`: every command takes both, before its words and after them."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main
from typer.testing import CliRunner

from racines_data import terminal
from racines_data.progress import progress_bar
from racines_leaderboard.cli.command import COMMANDS, GROUPS, app
from racines_leaderboard.cli.everywhere import SECTIONS
from tests.conftest import ROOT

CHEAP = (
    "weights list",
    "weights card flow",
    "board pin phantom-default --force --results {results}",
    "study weightings phantom-default --results {results}",
    "leaderboard --board phantom-default --results {results}",
    "audit planner --board phantom-default --quick --results {results}",
    "data validate {data}",
    "submit {new} --new",
)
"""Commands that need seconds at most, with what they need."""


@pytest.fixture(autouse=True)
def loud(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Begin without the variables of `--quiet`, and leave none."""
    for name in (terminal.QUIET, *terminal.HUSHED):
        monkeypatch.setenv(name, "0")  # noted, so that it is put back
    yield


def asked(words: str) -> Any:
    found: Any = typer.main.get_command(app)
    for word in words.split():
        found = found.commands[word]
    return found


@pytest.mark.parametrize("words", COMMANDS)
def test_every_command_takes_both(words: str):
    options = {each for param in asked(words).params for each in param.opts}
    assert {"--json", "--quiet", "-q"} <= options
    page = CliRunner().invoke(app, ["--json", "-q", *words.split(), "--json", "-q", "-h"])
    assert page.exit_code == 0 and f"{words} [OPTIONS]" in page.stdout


@pytest.mark.parametrize("line", CHEAP, ids=[" ".join(each.split()[:2]) for each in CHEAP])
def test_one_document_on_stdout_and_nothing_on_stderr(
    line: str, tiny_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(ROOT)
    results = tmp_path / "results"  # a copy: who pins would write there
    shutil.copytree(ROOT / "leaderboard/results/phantom-default", results / "phantom-default")
    words = line.format(results=results, data=tiny_root, new=tmp_path / "mine").split()
    flags = ["--json", "--quiet"]
    done = CliRunner().invoke(app, [*flags, *words] if CHEAP.index(line) % 2 else [*words, *flags])
    assert isinstance(done.exception, SystemExit | None), done.output
    assert isinstance(json.loads(done.stdout), dict | list)
    assert done.stderr == ""


def test_notes_are_left_out_and_warnings_are_not(capsys: pytest.CaptureFixture[str]):
    terminal.note("a note")
    terminal.be_quiet()
    terminal.note("another")
    terminal.say("a warning", err=True)
    terminal.say("a result")
    told = capsys.readouterr()
    assert told.err == "a note\na warning\n" and told.out == "a result\n"


def test_no_bar_is_drawn(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("FORCE_COLOR", "1")  # which makes any stream a terminal, to rich
    assert not progress_bar(True).disable
    terminal.be_quiet()
    assert progress_bar(True).disable


@pytest.mark.parametrize(("value", "silent"), [("1", True), ("0", False), ("", False)])
def test_the_variable_does_as_the_option(value: str, silent: bool, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv(terminal.QUIET, value)
    assert terminal.quiet() == silent
    CliRunner().invoke(app, ["weights", "list"])
    assert all((terminal.os.environ[name] == "1") == silent for name in terminal.HUSHED)


def test_json_alone_asks_for_nothing():
    assert CliRunner().invoke(app, ["--json", "nonsense"]).exit_code == 2
    assert CliRunner().invoke(app, ["--json", "study"]).exit_code == 2


def test_the_roots_sections_hold_every_command_once():
    named = [name for names in SECTIONS.values() for name in names]
    assert sorted(named) == sorted({words.split()[0] for words in (*COMMANDS, *GROUPS)})


@pytest.mark.parametrize("words", ["", *GROUPS])
def test_help_of_groups_fits_a_terminal_and_ends_no_line_in_dots(
    words: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("NO_COLOR", "1")
    page = CliRunner().invoke(app, [*words.split(), "-h"]).stdout
    assert max(map(len, page.splitlines())) <= 80 and "\x1b" not in page
    assert "..." not in page.split("\n", 1)[1]
