"""The terminal of `racines drive`: single keys in, pictures out; works over SSH."""

import os
import re
import termios
import tty
from collections.abc import Iterator
from typing import Any

from racines_data.errors import RacinesError
from racines_envs.driving.keyboard import Drive, screen

_KEY = re.compile(r"\x1b\[[0-9;]*[A-Za-z~]|.", re.DOTALL)
_ENTER, _LEAVE = "\x1b[?1049h\x1b[?25l\x1b[2J", "\x1b[0m\x1b[?25h\x1b[?1049l"


class Terminal:
    """Keys without Enter, on the other screen; as it was before on leaving.

    with Terminal() as terminal:
        run(drive, terminal.keys(), terminal.show)
    """

    def __init__(self, keys: int = 0, out: int = 1) -> None:
        """Use file descriptors, by default standard input and output, which are a terminal's."""
        if not (os.isatty(keys) and os.isatty(out)):
            raise RacinesError("racines drive needs a terminal: run it in one, or give --keys")
        self._in, self._out = keys, out
        self._before: list[Any] = []
        self._true_colour = os.environ.get("COLORTERM", "") in ("truecolor", "24bit")

    def __enter__(self) -> "Terminal":
        """Take the terminal."""
        self._before = termios.tcgetattr(self._in)
        tty.setraw(self._in)
        self._write(_ENTER)
        return self

    def __exit__(self, *raised: object) -> None:
        """Give it back as it was."""
        self._write(_LEAVE)
        termios.tcsetattr(self._in, termios.TCSADRAIN, self._before)

    def keys(self) -> Iterator[str]:
        """Yield keys as they are pressed; an arrow is one key. Ends where the input does."""
        while True:
            try:
                data = os.read(self._in, 256)
            except OSError:  # the terminal has gone
                return
            if not data:
                return
            yield from _KEY.findall(data.decode(errors="ignore"))

    def show(self, drive: Drive) -> None:
        """Draw over what was there."""
        size = os.get_terminal_size(self._out)
        columns, rows = size.columns or 80, size.lines or 24
        self._write("\x1b[H" + screen(drive, columns, rows, self._true_colour) + "\x1b[J")

    def _write(self, text: str) -> None:
        data = text.encode()
        while data:
            data = data[os.write(self._out, data) :]
