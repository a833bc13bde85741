"""What may have been meant where a command or an option is misspelt.

Typer proposes commands of the same group; here options are proposed in the same words, and commands
that stand in another group: `racines validate` for `racines data validate`.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any

import typer

UsageError: Any = typer.BadParameter.__base__  # which typer has no public name for
MEANT = "Did you mean"


@contextmanager
def suggesting(root: Any) -> Iterator[None]:
    """Let a bad usage inside say what may have been meant, of all commands of a root group."""
    try:
        yield
    except UsageError as error:
        _suggest(error, root)
        raise


def _suggest(error: Any, root: Any) -> None:
    """Add to the message of a bad usage what may have been meant; once, if there is something."""
    if options := getattr(error, "possibilities", None):
        error.possibilities = None  # else they are told again, in other words
        error.message = _asking(error.message, sorted(options))
    elif error.message.startswith("No such command ") and MEANT not in error.message:
        typo = error.message.split("'")[1] if error.message.count("'") > 1 else ""
        if near := near_commands(typo, list(words_of(root))):
            error.message = _asking(error.message, [f"racines {each}" for each in near])


def _asking(message: str, meant: list[str]) -> str:
    return f"{message.rstrip('.')}. {MEANT} {', '.join(map(repr, meant))}?"


def near_commands(typo: str, commands: Iterable[str]) -> list[str]:
    """Return the commands, at most three, of which a word is like one that is misspelt."""
    ends: dict[str, list[str]] = {}
    for words in commands:
        ends.setdefault(words.rpartition(" ")[2], []).append(words)
    found = [words for end in get_close_matches(typo, ends, cutoff=0.75) for words in ends[end]]
    return found[:3]


def words_of(group: Any, before: str = "") -> Iterator[str]:
    """Yield all commands of a group by their words."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from words_of(command, f"{before}{name} ")
        else:
            yield f"{before}{name}"
