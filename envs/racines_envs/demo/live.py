"""The search as it happens, in the terminal."""

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from PIL import Image

from racines_data.errors import RacinesError
from racines_data.terminal import console
from racines_envs.demo.chestmap import ChestMap
from racines_envs.demo.episode import Draw
from racines_envs.demo.film import ultrasound
from racines_envs.demo.watching import Shot
from racines_envs.driving.keyboard import half_blocks

SIDE = 208


class LiveView:
    """Ultrasound and map in half blocks on stderr, with a line of words.

    with LiveView() as live:
        live(chest, shots, draw)
    """

    def __init__(self, screen: Any = None) -> None:
        """Take a console of rich; that of stderr by default, which has to be a terminal's."""
        from rich.live import Live

        self._console = screen or console(err=True)
        if not self._console.is_terminal:
            raise RacinesError("--live needs a terminal: leave it out, and open the page instead")
        self._true = os.environ.get("COLORTERM", "") in ("truecolor", "24bit")
        self._live = Live(console=self._console, auto_refresh=False)

    def __enter__(self) -> "LiveView":
        """Begin."""
        self._live.start()
        return self

    def __exit__(self, *raised: object) -> None:
        """Leave the last picture standing."""
        self._live.stop()

    def __call__(self, chest: ChestMap, shots: Sequence[Shot], draw: Draw) -> None:
        """Show the last of the shots."""
        from rich.text import Text

        shot = shots[-1]
        pair = Image.new("RGB", (2 * SIDE, SIDE))
        pair.paste(ultrasound(shot.image, SIDE), (0, 0))
        pair.paste(chest.picture(shots, shot, draw.view, False).resize((SIDE, SIDE)), (SIDE, 0))
        columns = max(16, min(self._console.width - 1, 4 * (self._console.height - 4)))
        rows = max(4, columns // 4)
        lines = half_blocks(np.asarray(pair), columns, rows, self._true)
        words = (
            f"step {shot.step}: it believes {draw.view} {shot.believed:.0f} ± {shot.spread:.0f} mm "
            f"away, in truth {shot.distance:.0f} mm; grade read {max(shot.read, 0.0):.1f}, "
            f"true {shot.grade:.1f}"
        )
        self._live.update(Text.from_ansi("\n".join([*lines, words])), refresh=True)
