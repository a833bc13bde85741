"""Devices by name: one reading and one refusal, for every command that has `--device`."""

from collections.abc import Iterator
from typing import Any

import pytest
import typer.main
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_leaderboard.cli.command import app
from racines_models.devices import resolve_device

ABSENT = "cuda:97"


def _commands(group: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Yield every command that has `--device`, with its required arguments filled in."""
    for name, command in getattr(group, "commands", {}).items():
        yield from _commands(command, (*words, name))
    if any("--device" in each.opts for each in group.params):
        for each in group.params:
            if each.required:
                words += (
                    ("x.parquet",)
                    if each.param_type_name == "argument"
                    else (each.opts[0], "x.parquet")
                )
        yield words


COMMANDS = list(_commands(typer.main.get_command(app)))


def test_the_commands_were_found():
    assert len(COMMANDS) > 15


@pytest.mark.parametrize("words", COMMANDS, ids=lambda words: " ".join(words))
@pytest.mark.parametrize("device", [ABSENT, "banana"])
def test_every_command_refuses_it_before_anything_else(words, device, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, [*words, "--device", device])
    assert isinstance(result.exception, RacinesError)
    assert f"device {device!r}: there is none here: use auto, cpu" in str(result.exception)
    assert not list(tmp_path.iterdir())


def test_names(monkeypatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    assert resolve_device("auto") == resolve_device("cpu") == "cpu"
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    monkeypatch.setattr("torch.cuda.device_count", lambda: 2)
    assert resolve_device("auto") == "cuda" and resolve_device("cuda:1") == "cuda:1"
    with pytest.raises(RacinesError, match="use auto, cpu, cuda, cuda:0, cuda:1"):
        resolve_device("cuda:2")
    monkeypatch.setenv("LOCAL_RANK", "1")
    assert resolve_device("auto") == "cuda:1" and resolve_device("cpu") == "cpu"
