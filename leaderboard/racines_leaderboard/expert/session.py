"""A rater's sitting, which a labelling page drives: next image, save, progress; resumed by name.

    session = Session.open(kit_folder, ratings_folder, "anna")
    while (image := session.next_image()) is not None:
        show(kit.image_path(image))
        session.save(image, view, grade, seconds)

A session holds no open file and knows no other rater's answers, so a page may open one for every
request. An image is answered once: a second thought after other images would not be blind.
"""

import fcntl
import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from racines_data.errors import RacinesError
from racines_leaderboard.expert.kit import Kit
from racines_leaderboard.expert.ratings import SCHEMA, check_rater, parse
from racines_leaderboard.records.experts import EXPERT

ABOUT = 200
"""Longest description of a rater, characters."""


@dataclass(frozen=True)
class Progress:
    """How far a rater is."""

    done: int
    total: int


@dataclass
class Session:
    """One rater at one kit; the name must be fit, and the file of that kit and kind."""

    kit: Kit
    path: Path
    """The file of the ratings."""
    rater: str
    """A pseudonym of a-z, 0-9 and single dashes."""
    kind: str = EXPERT
    """Or `trial`, for somebody who tries the page out."""
    about: str = ""
    """What the report says of the rater, as `sonographer, 12 years`."""
    seed: int = 0
    """Decides the order together with the kit and the name."""

    def __post_init__(self) -> None:
        if len(self.about) > ABOUT:
            length = f"{len(self.about)} characters, at most {ABOUT}"
            raise RacinesError(f"rater {self.rater}: about: {length}")
        check_rater(self.rater, self.kind)
        self.order = order_of(self.kit, self.rater, self.seed)
        """All images in the order in which this rater sees them."""
        self._answered: set[str] = set()
        self._read = 0
        if self.path.exists():
            self._catch_up(self.path.read_bytes())

    @classmethod
    def open(
        cls,
        kit: Kit | Path | str,
        ratings: Path | str,
        rater: str,
        kind: str = EXPERT,
        about: str = "",
        seed: int = 0,
    ) -> "Session":
        """Begin or resume at a kit or its folder; the ratings lie in `ratings/RATER.jsonl`."""
        kit = kit if isinstance(kit, Kit) else Kit.open(kit)
        path = Path(ratings) / f"{check_rater(rater, kind)}.jsonl"
        return cls(kit, path, rater, kind, about, seed)

    def next_image(self) -> str | None:
        """Return the first image without an answer; None when all have one."""
        return next((image for image in self.order if image not in self._answered), None)

    def progress(self) -> Progress:
        """Return how many images have an answer."""
        return Progress(len(self._answered), len(self.order))

    def save(self, image: str, view: str, grade: int, seconds: float | None = None) -> None:
        """Append one answer; it is on the disk when this returns.

        Raises:
            RacinesError: unknown image or view, a grade off the scale, or a second answer.
        """
        fault = self.kit.fault(image, view, grade)
        if fault is None and seconds is not None and not 0 <= seconds < float("inf"):
            fault = f"image {image}: seconds {seconds}: give a time, or none"
        if fault is not None:
            raise RacinesError(fault)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a+b") as file:
            fcntl.flock(file, fcntl.LOCK_EX)  # two windows of one rater take turns
            file.seek(self._read)
            self._catch_up(file.read())
            if image in self._answered:
                raise RacinesError(f"rater {self.rater}: image {image} has an answer already")
            file.truncate(self._read)  # what a crash left of a line
            record = {"schema": SCHEMA, "kit": self.kit.digest, "rater": self.rater}
            record |= {"kind": self.kind, "about": self.about, "image": image, "view": view}
            taken = None if seconds is None else round(float(seconds), 3)
            record |= {"grade": int(grade), "seconds": taken}
            line = json.dumps(record, ensure_ascii=False).encode() + b"\n"
            file.write(line)
            file.flush()
            os.fsync(file.fileno())
        if self._read == 0:  # a new file's name outlives a crash, as its content does
            handle = os.open(self.path.parent, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)
        self._answered.add(image)
        self._read += len(line)

    def _catch_up(self, text: bytes) -> None:
        """Take in the complete lines that stand in the file since it was last read."""
        for record in parse(text, str(self.path), self.kit):
            for key in ("rater", "kind", "about"):
                if record.get(key, "") != getattr(self, key):
                    raise RacinesError(
                        f"{self.path}: {key} {record.get(key)!r}, not {getattr(self, key)!r}: "
                        "give what was given at first, or another name"
                    )
            self._answered.add(record["image"])
        self._read += text.rfind(b"\n") + 1


def order_of(kit: Kit, rater: str, seed: int = 0) -> list[str]:
    """Return the kit's images in a rater's order: blocks shuffled, forwards or backwards."""
    digest = hashlib.sha256(f"{kit.digest} {rater} {seed}".encode()).digest()
    rng = np.random.default_rng(int.from_bytes(digest[:16], "big"))
    blocks = [[block[i] for i in rng.permutation(len(block))] for block in kit.blocks]
    if rng.random() < 0.5:
        blocks.reverse()
    return [image for block in blocks for image in block]
