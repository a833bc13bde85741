"""What every command takes, before its words and after them: `--quiet` and `--json`.

`--json` is an option of each command, which knows what it has to tell; before the words it is
handed on. `--quiet` is added here, to all of them.
"""

import inspect
from collections.abc import Callable
from functools import wraps
from typing import Any

from typer.core import TyperGroup

from racines_data.cli import options as opt
from racines_data.terminal import be_quiet

SECTIONS = {
    "Begin": ("demo", "doctor", "studio"),
    "Data": ("data", "phantom"),
    "Generators and agents": ("train", "eval", "study", "export", "weights"),
    "Episodes": ("drive", "replay", "explain"),
    "Boards": ("submit", "leaderboard", "audit", "board", "expert"),
}
"""The root's commands, by what one wants; others' packages come last."""


def with_quiet(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a command that takes `--quiet` as well, behind its own options."""

    @wraps(function)
    def command(*args: Any, quiet: bool = False, **options: Any) -> Any:
        if quiet:
            be_quiet()
        return function(*args, **options)

    signature = inspect.signature(function)
    kind = inspect.Parameter.KEYWORD_ONLY
    added = inspect.Parameter("quiet", kind, default=False, annotation=opt.Quiet)
    parameters = [*signature.parameters.values(), added]
    setattr(command, "__signature__", signature.replace(parameters=parameters))  # noqa: B010
    command.__annotations__ = function.__annotations__ | {"quiet": opt.Quiet}
    return command


class Group(TyperGroup):
    """Commands whose help says all of what each does: where a line ends, it goes on below."""

    sections: dict[str, tuple[str, ...]] = {}

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands by section; those of none come last."""
        shown = {name: each for name, each in self.commands.items() if not each.hidden}
        named = {name for names in self.sections.values() for name in names}
        others = tuple(name for name in shown if name not in named)
        last = ("Others" if named else "Commands", others)
        for title, names in (*self.sections.items(), last):
            width = 4 * formatter.width
            rows = [(n, shown[n].get_short_help_str(width)) for n in names if n in shown]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows, col_max=12 if named else 30)


def handed_on(words: list[str], groups: Any) -> list[str]:
    """Return a command line with `--json` behind the command's own words."""
    count = 2 if words[0] in groups else 1
    return [*words[:count], "--json", *words[count:]] if len(words) >= count else words
