"""The help of `racines`: -h, examples that parse, exit codes, suggestions, completion."""

from pathlib import Path
from typing import Any

import pytest
import typer.main
from typer.testing import CliRunner

from racines_leaderboard.cli.command import COMMANDS, GROUPS, app
from racines_leaderboard.cli.examples import EXAMPLES, EXIT_CODES
from racines_leaderboard.cli.suggest import near_commands
from tests.conftest import command


@pytest.mark.parametrize("words", ["", "data", "data validate", "weights card", "doctor"])
def test_h_is_help(words: str):
    short, long = (
        CliRunner().invoke(app, [*words.split(), option], prog_name="racines")
        for option in ("-h", "--help")
    )
    assert short.exit_code == 0 and short.stdout == long.stdout
    assert f"Usage: racines {words}" in short.stdout and "-h, --help" in short.stdout


def test_the_root_fits_a_terminal_and_tells_the_exit_codes(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("COLUMNS", "80")
    page = CliRunner().invoke(app, ["-h"]).stdout
    assert max(map(len, page.splitlines())) <= 80 and "\x1b" not in page
    for code, meaning in EXIT_CODES.items():
        assert f"    {code}  {meaning}\n" in page
    assert all(f"\n  {name} " in page for name in GROUPS)


def test_every_main_command_has_an_example():
    assert set(EXAMPLES) == {words for words in COMMANDS if not words.startswith("study ")}


@pytest.mark.parametrize("words", EXAMPLES)
def test_an_example_is_of_its_command_and_parses(words: str):
    line = EXAMPLES[words]
    assert f"Example:\n    {line}\n" in CliRunner().invoke(app, [*words.split(), "-h"]).stdout
    assert f"{line} ".startswith(f"racines {words} ")
    found: Any = typer.main.get_command(app)
    for word in words.split():
        found = found.commands[word]
    with found.make_context(words, line.split()[1 + len(words.split()) :]):
        pass


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        ("dta", "'data'"),
        ("data validat", "'validate'"),
        ("validate", "'racines data validate'"),
        ("train build", "'racines data build'"),
        ("--versio", "'--version'"),
        ("data build --profle smoke", "'--profile'"),
    ],
)
def test_a_slip_is_answered_with_what_may_be_meant(words: str, meant: str):
    done = CliRunner().invoke(app, words.split())
    assert done.exit_code == 2
    told = done.stderr.splitlines()[-1]
    assert told.count("Did you mean") == 1 and meant in told and "Possible" not in told


def test_what_is_like_nothing_is_answered_with_nothing():
    done = CliRunner().invoke(app, ["xyzzy"])
    assert done.exit_code == 2 and "Did you mean" not in done.stderr
    assert near_commands("", COMMANDS) == [] and len(near_commands("generator", COMMANDS)) == 3


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_each_shell_gets_a_script_and_commands_and_options(
    shell: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def complete(line: str) -> str:
        if shell == "bash":
            monkeypatch.setenv("COMP_WORDS", line)
            monkeypatch.setenv("COMP_CWORD", str(len(line.split(" ")) - 1))
        monkeypatch.setenv("_RACINES_COMPLETE", f"complete_{shell}")
        monkeypatch.setenv("_TYPER_COMPLETE_ARGS", line)
        monkeypatch.setenv("_TYPER_COMPLETE_FISH_ACTION", "get-args")
        return CliRunner().invoke(app, [], prog_name="racines").stdout

    assert "weights" in complete("racines we") and "validate" in complete("racines data va")
    assert "--against" in complete("racines data validate --")
    monkeypatch.delenv("_RACINES_COMPLETE")
    monkeypatch.setenv("_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION", "1")
    script = command(tmp_path, "racines", "--show-completion", shell, fresh=True).stdout
    assert f"_RACINES_COMPLETE=complete_{shell}" in script
