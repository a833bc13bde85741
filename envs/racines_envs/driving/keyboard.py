"""Driving the probe by hand: keys to actions, the loop, and the terminal, also over SSH."""

import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from itertools import chain, groupby
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from racines_data.errors import RacinesError
from racines_data.escape import visible
from racines_data.files import image_bytes, write_atomic
from racines_envs.apis.rendering import IMAGE, History, compose, describe
from racines_envs.recordings.episodes import CoreRecorder
from racines_envs.task.actions import ACTIONS
from racines_envs.task.core import ScanCore

KEYS = {
    "d": "+x", "a": "-x", "w": "+y", "s": "-y", "f": "+z", "r": "-z",
    "i": "+rx", "k": "-rx", "l": "+ry", "j": "-ry", "o": "+rz", "u": "-rz",
    " ": "idle",
}  # fmt: skip
"""Which action each key is; x, y and z are the probe's axes, and +z goes into the block."""
ARROWS = {"\x1b[C": "d", "\x1b[D": "a", "\x1b[A": "w", "\x1b[B": "s"}
NEW, QUIT = "n", ("q", "\x03", "\x04")
HELP = (
    "d/a  +x/-x   w/s  +y/-y   f  press   r  lift   (arrows: x and y of the probe)",
    "i/k  +rx/-rx   l/j  +ry/-ry   o/u  +rz/-rz   space  idle   n  new start   q  quit",
)
"""What is shown under the picture."""
WIDE = 100
"""Columns from which the views of the block have room beside the image."""
_KEY = re.compile(r"\x1b\[[0-9;]*[A-Za-z~]|.", re.DOTALL)
_ENTER, _LEAVE = "\x1b[?1049h\x1b[?25l\x1b[2J", "\x1b[0m\x1b[?25h\x1b[?1049l"


class Drive:
    """A person at the one row of a core."""

    def __init__(
        self, core: ScanCore, seed: int = 0, png: Path | None = None, record: Path | None = None
    ) -> None:
        """Start the first episode in a core of one row; `n` goes on to the next of the seed.

        `png` is a file to renew with the picture after every key, `record` a folder for the
        episodes' JSONL and GIF.
        """
        self.core, self.history, self._png = core, History(1), png
        self._recorder = CoreRecorder(core, record) if record else None
        self._begin(seed)

    def _begin(self, seed: int | None) -> None:
        self.core.reset(seed)
        self.history.note(self.core)
        if self._recorder:
            self._recorder.start([seed])
        self._show()

    def press(self, key: str) -> bool:
        """Do what a key says and return whether to go on; keys of no meaning do nothing."""
        key = ARROWS.get(key, key)
        if key in QUIT:
            return False
        if key == NEW:
            self._begin(None)
        elif key in KEYS and not bool(self.core.state.done[0]):
            action = torch.tensor([ACTIONS.index(KEYS[key])], device=self.core.device)
            transition = self.core.step(action)
            self.history.note(self.core, action)
            if self._recorder:
                self._recorder.step(action, transition)
            self._show()
        return True

    def close(self) -> None:
        """Write what is being recorded."""
        if self._recorder:
            self._recorder.finish()

    def picture(self) -> np.ndarray:
        """Return the present picture, (540, 960, 3) uint8."""
        return compose(self.core, 0, self.history)

    def words(self) -> list[str]:
        """Return the state in words, then the keys."""
        lines = describe(self.core, 0, self.history[0])
        if bool(self.core.state.done[0]):
            lines[-1] += ": n starts anew, q quits"
        return [*lines, "", *HELP]

    def _show(self) -> None:
        if self._png:
            write_atomic(self._png, image_bytes(Image.fromarray(self.picture())))


def run(drive: Drive, keys: Iterable[str], show: Callable[[Drive], None] | None = None) -> None:
    """Show, take a key, and so on until one says to quit or there are no more."""
    try:
        for key in chain([""], keys):  # no key at first, to show the start
            if not drive.press(key):
                break
            if show:
                show(drive)
    finally:
        drive.close()


def screen(drive: Drive, columns: int, rows: int, true_colour: bool = True) -> str:
    """Return what a terminal of a size shows: the picture in half blocks, then words.

    A narrow terminal shows the ultrasound image alone. Lines end as a raw terminal wants them.
    """
    words = [visible(line)[: columns - 1] for line in drive.words()]
    room = max(4, rows - len(words) - 1)
    picture = drive.picture()
    picture = picture[:320] if columns >= WIDE else picture[:320, :IMAGE]
    height, width = picture.shape[:2]
    across = max(2, min(columns - 1, room * 2 * width // height))
    lines = half_blocks(picture, across, max(1, round(across * height / width / 2)), true_colour)
    return "".join(f"{line}\x1b[K\r\n" for line in [*lines, *words])


def half_blocks(
    picture: np.ndarray, columns: int, rows: int, true_colour: bool = True
) -> list[str]:
    """Turn an (H, W, 3) picture into lines of `▀`: upper pixel in front, lower behind.

    With `true_colour` 24 bits a pixel, else the 256 colours that every terminal knows.
    """
    small = Image.fromarray(picture).resize((columns, 2 * rows), Image.Resampling.BOX)
    pixels = np.asarray(small).astype(int)
    if true_colour:
        codes = [[f"2;{r};{g};{b}" for r, g, b in line] for line in pixels.tolist()]
    else:
        codes = [[f"5;{code}" for code in line] for line in _palette(pixels).tolist()]
    lines = []
    for upper, lower in zip(codes[::2], codes[1::2], strict=True):
        # A run of one colour needs it once: a slow line is glad of it.
        runs = groupby(zip(upper, lower, strict=True))
        parts = [f"\x1b[38;{u};48;{v}m" + "▀" * len(list(run)) for (u, v), run in runs]
        lines.append("".join(parts) + "\x1b[0m")
    return lines


def _palette(pixels: np.ndarray) -> np.ndarray:
    """Return the xterm codes of (H, W, 3) levels: 24 grays where gray, else the 6³ cube."""
    gray = 232 + np.clip((pixels.mean(-1) - 8) / 10, 0, 23).round().astype(int)
    r, g, b = np.moveaxis((pixels * 5 + 127) // 255, -1, 0)
    cube = 16 + 36 * r + 6 * g + b
    return np.where(np.ptp(pixels, -1) < 12, gray, cube)


class Terminal:
    """Keys without Enter, on the other screen; as it was before on leaving.

    with Terminal() as terminal:
        run(drive, terminal.keys(), terminal.show)
    """

    def __init__(self, keys: int = 0, out: int = 1) -> None:
        """Use file descriptors, by default standard input and output, which are a terminal's."""
        if not (os.isatty(keys) and os.isatty(out)):
            raise RacinesError("racines drive needs a terminal: run it in one, or give --keys")
        if sys.platform == "win32":
            raise RacinesError(
                "racines drive needs a POSIX terminal, which Windows (win32) has not: give --keys, "
                "or drive in racines studio"
            )
        self._in, self._out = keys, out
        self._before: list[Any] = []
        self._true_colour = os.environ.get("COLORTERM", "") in ("truecolor", "24bit")

    def __enter__(self) -> "Terminal":
        """Take the terminal."""
        import termios
        import tty

        self._before = termios.tcgetattr(self._in)
        tty.setraw(self._in)
        self._write(_ENTER)
        return self

    def __exit__(self, *raised: object) -> None:
        """Give it back as it was."""
        import termios

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
