"""A demonstration from the draw to the files."""

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.files import locked, write_atomic, write_json
from racines_data.geometry import Pose
from racines_data.patients.heart import Heart
from racines_envs.demo.chestmap import ChestMap
from racines_envs.demo.episode import Draw, Outcome, scan
from racines_envs.demo.film import film
from racines_envs.demo.page import page
from racines_envs.demo.watching import Shot, Watched

SCHEMA = "racines.demo/1"
PAGE, FILM, FIGURES = "index.html", "demo.gif", "demo.json"


def next_commands(draw: Draw) -> list[tuple[str, str]]:
    """Return three commands to go on with, and what each does."""
    tier = f"--view {draw.view} --tier {draw.tier}"
    score = f"racines eval agent servo {tier} --patients 3"
    return [
        ("racines studio", "Look at boards, scans and agents in the browser."),
        (score, "Score the same agent on three validation patients."),
        ("racines train agent ppo --view SC --reward oracle --frames 20000",
         "Train an agent of your own; a first try takes minutes."),
    ]  # fmt: skip


def check_folder(out: Path, force: bool) -> None:
    """Refuse a folder that holds something else.

    Raises:
        RacinesError: what is there is no folder, or one of another kind and not `force`.
    """
    if os.path.lexists(out) and not out.is_dir():
        raise RacinesError(f"{out}: is there and no folder: name another with --out")
    if force or not out.is_dir() or not any(out.iterdir()):
        return
    try:
        own = json.loads((out / FIGURES).read_text(encoding="utf-8")).get("schema") == SCHEMA
    except (FileNotFoundError, ValueError, AttributeError):
        own = False
    if not own:
        raise RacinesError(
            f"{out}: a folder that no demonstration wrote: name another with --out, or --force to "
            "write into it"
        )


class Painter:
    """Makes the map of the chest once, for what is shown live and what is written."""

    def __init__(self) -> None:
        """Begin without one."""
        self._map: ChestMap | None = None

    def of(self, heart: Heart, own: Pose) -> ChestMap:
        """Return the map."""
        self._map = self._map or ChestMap(heart, own)
        return self._map


def demonstrate(
    draw: Draw, agent: Watched, out: Path, live: Any = None, steps: int | None = None
) -> Outcome:
    """Scan a patient and write page, film and figures into a folder.

    Args:
        draw: who, how and from where.
        agent: who looks.
        out: the folder; `check_folder` says whether it may be written.
        live: called with map and shots at each step; nothing by default.
        steps: stop after so many; the task's own by default.
    """
    painter = Painter()

    def seen(heart: Heart, own: Pose, shots: Sequence[Shot]) -> None:
        if live:
            live(painter.of(heart, own), shots, draw)

    outcome = scan(draw, agent, seen, steps)
    chest = painter.of(outcome.heart, outcome.own)
    moving, text = film(outcome, chest), page(outcome, chest, next_commands(draw))
    with locked(out):
        # The figures first: by them a folder is known as ours, also one that was left half-way.
        write_json(out / FIGURES, {"schema": SCHEMA} | outcome.told)
        write_atomic(out / FILM, moving)
        write_atomic(out / PAGE, text)
    return outcome
