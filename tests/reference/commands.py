"""The page of the commands, from the tree that `racines` itself runs."""

import inspect
import re
from collections.abc import Callable
from typing import Any

import typer.main

from racines_data.tables import Markdown, code, markdown_table
from racines_leaderboard.cli.command import COMMANDS, GROUPS, HELP, app
from racines_leaderboard.cli.everywhere import SECTIONS
from racines_leaderboard.cli.examples import EXAMPLES, EXIT_CODES

EVERYWHERE = {"--json", "--quiet"}
HEAD = """# Commands

Every command of `racines` with its arguments and options, drawn from the code by
`python -m tests.reference`. The same stands in the terminal behind `-h`.

## Of every command

| option | what it does |
| --- | --- |
| `--json` | one JSON document on stdout, in place of text and tables |
| `-q`, `--quiet` | no progress and no notes on stderr; results, warnings and errors stay |
| `-h`, `--help` | the help of the command, with an example |

The first two stand before the command or after it: `racines --json doctor` is
`racines doctor --json`. The variable `RACINES_QUIET=1` does as `--quiet` for all commands of a
shell. Colours are left out where `NO_COLOR` is set or the output is no terminal.

`racines --version` prints the version. `racines --verify COMMAND` hashes every file of a dataset
again, changed or not. `racines --install-completion` installs
[completion](first-hour.md#completion).

## Exit codes
"""


def page() -> str:
    """Return the page in Markdown."""
    exits = markdown_table(("code", "meaning"), [(code(n), told) for n, told in EXIT_CODES.items()])
    parts = [f"{HEAD}\n{exits}\n\nA refused command leaves nothing half-written.\n"]
    for title, names in SECTIONS.items():
        parts.append(f"## {title}\n")
        for name in names:
            parts += [f"**`racines {name}`.** {GROUPS[name]}\n"] if name in GROUPS else []
            parts += [_command(words) for words in COMMANDS if words.split()[0] == name]
    return "\n".join(parts)


def asked(words: str) -> Any:
    """Return the command of these words."""
    found: Any = typer.main.get_command(app)
    for word in words.split():
        found = found.commands[word]
    return found


def _command(words: str) -> str:
    found = asked(words)
    # A command keeps the help option of the first context that it meets.
    context = found.context_class(found, info_name=f"racines {words}", help_option_names=HELP)
    told = inspect.cleandoc(found.help or "")
    usage = " ".join([f"racines {words}", *found.collect_usage_pieces(context)])
    parts = [f"### `racines {words}`", _marked(told), f"Usage: {code(usage)}"]
    if words in EXAMPLES:
        parts.append(f"Example: {code(EXAMPLES[words])}")
    rows = [_row(each, context) for each in found.params if not set(each.opts) & EVERYWHERE]
    if rows:
        parts.append(markdown_table(("argument or option", "default, range", "what it is"), rows))
    return "\n\n".join(parts) + "\n"


def _row(param: Any, context: Any) -> tuple[Markdown, Markdown, Markdown]:
    """Return the row of a parameter, from what the terminal's help says of it."""
    name, told = param.get_help_record(context)
    told, _, facts = told.partition("  [")  # such as [default: 7860; 1<=x<=65535] or [required]
    facts = facts.removesuffix("]").replace("]  [", "; ").removeprefix("default: ")
    facts = facts.replace("required", "needed")
    shown = Markdown(facts) if " " in facts or facts == "needed" else code(facts)
    return code(name.replace(" range", "")), shown, _marked(told)


_WORDS = re.compile(
    r"(?<![\w`])(--[a-z][\w-]*|[\w.<>-]+(?:(?:/[\w.<>-]*[\w>])+/?|/(?!\w))"
    r"|[\w<>-]+\.(?:yaml|json|png|md))"
)


def _marked(text: str) -> Markdown:
    """Return help as Markdown: options and places in code letters."""
    marked = _beside_code(text.replace("|", "\\|"), lambda part: _WORDS.sub(r"`\1`", part))
    return Markdown(_beside_code(marked, lambda part: part.replace("<", "&lt;")))


def _beside_code(text: str, change: Callable[[str], str]) -> str:
    """Change what does not stand in code letters."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(part if at % 2 else change(part) for at, part in enumerate(parts))
