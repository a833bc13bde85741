"""Commands and options that have another name now; the old ones still work, and say the new one."""

from collections.abc import Iterator
from typing import Any

from racines_data.terminal import say
from racines_leaderboard.cli.everywhere import SECTIONS, Group, handed_on
from racines_leaderboard.cli.suggest import suggesting

COMMANDS = {
    "phantom sheet": "study sheet",
    "data leakage": "study leakage",
    "determinism": "study determinism",
    "expert simulate": "expert rate --by simulated",
    "expert oracle": "expert rate --by oracle",
}
_STUDIES = "gallery realism ablation floor conditioning transfer rewards curves forces speed"
COMMANDS |= {f"eval {name}": f"study {name}" for name in _STUDIES.split()}
OPTIONS = {
    "train agent": {"--run-dir": "--out"},
    "eval agent": {"--run-dir": "--run", "--scores": "--out", "--latency": "--set=latency="},
    "explain": {
        "--run-dir": "--run",
        "--every": "--set=every=",
        "--frames": "--set=frames=",
        "--steps": "--set=steps=",
        "--random-maps": "--set=random_maps=",
    },
    "study speed": {"--steps": "--set=steps="},
    "export trace": {"--run-dir": "--run"},
    "study rewards": {"--reward": "--rewards"},
    "submit": {"--replace": "--force"},
    "expert rate": {"--grader": "--by=grader"},
}


def renamed(words: list[str]) -> list[str]:
    """Return the words of a command line by their names of today; say on stderr what changed."""
    for count in (2, 1):
        old = " ".join(words[:count])
        if old in COMMANDS:
            _tell(old, COMMANDS[old])
            words = [*COMMANDS[old].split(), *words[count:]]
            break
    options = OPTIONS.get(" ".join(words[:2])) or OPTIONS.get(words[0]) or {}
    return list(_options(iter(words), options))


def _options(words: Iterator[str], options: dict[str, str]) -> Iterator[str]:
    for word in words:
        name, equals, value = word.partition("=")
        if name not in options:
            yield word
            continue
        new = options[name]
        _tell(name, new)
        # An option that became a setting takes its value into the same word.
        yield new + (value or next(words, "")) if new.endswith("=") else new + equals + value


def _tell(old: str, new: str) -> None:
    say(f"racines: {old} is an old name of: {new}", err=True)


class RenamingGroup(Group):
    """The root of the commands: takes old names without listing them, and says what is meant."""

    sections = SECTIONS

    def make_context(self, *args: Any, **settings: Any) -> Any:
        """Read the root's own options."""
        with suggesting(self):
            return super().make_context(*args, **settings)

    def invoke(self, ctx: Any) -> Any:
        """Run the command that is named."""
        with suggesting(self):
            return super().invoke(ctx)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command by its name of today; it gets `--json` where that stands before it."""
        words = renamed(args)
        if ctx.params.get("as_json"):
            groups = [name for name, each in self.commands.items() if hasattr(each, "commands")]
            words = handed_on(words, groups)
        return super().resolve_command(ctx, words)
