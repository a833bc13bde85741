"""Code blocks of a Markdown page, and how they are run."""

import os
import re
import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FENCE = re.compile(
    r"^(?:<!-- not run: ([^\n]+) -->\n)?```(\w+)[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL
)
FILE = re.compile(r"# ([\w./-]+\.(?:py|yaml|toml))\n")
"""First line of a block that is a file: its name."""
SHELL = set("|&;<*`(")
"""A line with one of these needs a shell."""


@dataclass(frozen=True)
class Block:
    """One fenced block."""

    language: str
    text: str
    reason: str = ""
    """Why it is not run, by the comment `<!-- not run: … -->` above it."""

    @property
    def file(self) -> str | None:
        """The file that the block is, by its first line."""
        named = FILE.match(self.text)
        return named[1] if named else None


def blocks(page: Path) -> list[Block]:
    """Return the fenced blocks of a page that name a language, in order."""
    found = FENCE.findall(page.read_text(encoding="utf-8"))
    return [Block(language, text, reason) for reason, language, text in found]


def command_lines(text: str) -> list[str]:
    """Return the commands of a shell block; lines that end in a backslash go on."""
    lines = text.replace("\\\n", " ").splitlines()
    return [line for line in lines if line.strip() and not line.lstrip().startswith("#")]


def run_page(page: Path, folder: Path, command: Callable[..., Any]) -> int:
    """Write a page's files and run its Python and bash blocks in a folder; return how many ran.

    Python blocks share their names from one to the next until a bash block comes between. Each line
    of a bash block is a command of its own. `command(folder, *words)` runs one.
    """
    ran, code = 0, ""
    for block in [*blocks(page), Block("bash", "")]:
        if block.reason:
            continue
        if block.language == "python" and not block.file:
            code += block.text + "\n\n"
            ran += 1
            continue
        if not block.file and block.language != "bash":
            continue  # a text or settings that others read
        if code:
            command(folder, "python", "-c", code)
            code = ""
        if block.file:
            path = folder / block.file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.text)
        else:
            for line in command_lines(block.text):
                run_line(line, folder, command)
                ran += 1
    return ran


def run_line(line: str, folder: Path, command: Callable[..., Any]) -> None:
    """Run a line of a bash block by `command(folder, *words)`, in a shell where it needs one."""
    words = shlex.split(os.path.expandvars(line), comments=True)
    if words[0] == "racines" and not SHELL & set(line):
        command(folder, *words)
    else:
        command(folder, "bash", "-euc", line)
