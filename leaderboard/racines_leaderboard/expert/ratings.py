"""Ratings: one JSON Lines file a rater, a line an answer, appended and never rewritten.

A line stands by itself: it names its kit and its rater. A last line without its end is what a
crash left of an answer that was never acknowledged; readers leave it out.

A rater's sitting, which a labelling page drives: next image, save, progress; resumed by name.

    session = Session.open(kit_folder, ratings_folder, "anna")
    while (image := session.next_image()) is not None:
        show(kit.image_path(image))
        session.save(image, view, grade, seconds)

A session holds no open file and knows no other rater's answers, so a page may open one for every
request. An image is answered once: a second thought after other images would not be blind.
"""

import hashlib
import json
import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jsonschema.exceptions import ValidationError, best_match

from racines_data.errors import RacinesError
from racines_data.files import locked
from racines_leaderboard.expert.kit import Kit
from racines_leaderboard.records.experts import EXPERT, KINDS, MACHINES
from racines_leaderboard.records.schema import validator

SCHEMA = "racines.ratings/1"
RATER = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
LONGEST = 32
SHOWN = 10
"""Most faults named at once."""
ABOUT = 200
"""Longest description of a rater, characters."""


@dataclass(frozen=True)
class Rating:
    """One answer."""

    image: str
    view: str
    grade: int
    seconds: float | None
    """Time from the image's appearance to the answer."""


@dataclass(frozen=True)
class Ratings:
    """What one rater answered."""

    rater: str
    kind: str
    about: str
    answers: dict[str, Rating]


def check_rater(rater: str, kind: str) -> str:
    """Return a rater's name; one that cannot name a file or misleads raises RacinesError."""
    if not RATER.fullmatch(rater) or len(rater) > LONGEST:
        raise RacinesError(
            f"rater {rater[:80]!r}: give a pseudonym of 1 to {LONGEST} of a-z, 0-9 and single '-'"
        )
    if kind not in KINDS:
        raise RacinesError(f"rater {rater}: kind {kind!r} is none of {', '.join(KINDS)}")
    word = rater.split("-")[0]
    if word in MACHINES and word != kind:
        raise RacinesError(f"rater {rater}: names that begin with {word} are kept for machines")
    return rater


def parse(text: bytes, where: str, kit: Kit) -> list[dict[str, Any]]:
    """Return the records of complete lines; RacinesError names those at fault and why."""
    checked = [_record(line, kit) for line in text.split(b"\n")[:-1]]
    faults = [f"line {n}: {fault}" for n, (_, fault) in enumerate(checked, 1) if fault is not None]
    _refuse(where, faults)
    return [record for record, _ in checked]


def read_ratings(path: Path, kit: Kit) -> Ratings:
    """Read one rater's answers to a kit.

    Raises:
        RacinesError: no such file, none in it, or faults: another kit's answers, unknown images
            or views, grades off the scale, images answered twice, several raters in one file.
    """
    try:
        text = path.read_bytes()
    except OSError as error:
        raise RacinesError(f"{path}: not readable: {error.strerror}") from error
    records = parse(text, str(path), kit)
    if not records:
        raise RacinesError(f"{path}: no ratings yet")
    first = {key: records[0].get(key, "") for key in ("rater", "kind", "about")}
    check_rater(first["rater"], first["kind"])
    answers, faults = {}, []
    for number, record in enumerate(records, 1):
        image = record["image"]
        if image in answers:
            faults.append(f"line {number}: image {image} is answered a second time")
        for key, value in first.items():
            if record.get(key, "") != value:
                faults.append(f"line {number}: {key} {record.get(key)!r}, but line 1 has {value!r}")
        answers[image] = Rating(image, record["view"], int(record["grade"]), record["seconds"])
    _refuse(str(path), faults)
    return Ratings(**first, answers=answers)


def read_all(paths: Sequence[Path], kit: Kit, partial: bool = False) -> list[Ratings]:
    """Read the files of raters of one kind; with `partial` also of who has not answered all."""
    if not paths:
        raise RacinesError("no ratings: name at least one file")
    everyone = [read_ratings(path, kit) for path in paths]
    names = [ratings.rater for ratings in everyone]
    for path, name in zip(paths, names, strict=True):
        if names.count(name) > 1:
            raise RacinesError(f"{path}: rater {name} has two files; give each rater's once")
    if len(kinds := sorted({ratings.kind for ratings in everyone})) > 1:
        raise RacinesError(f"ratings of {' and '.join(kinds)} raters: score each kind by itself")
    for path, ratings in zip(paths, everyone, strict=True):
        missing = [image for image in kit.images if image not in ratings.answers]
        if missing and not partial:
            raise RacinesError(
                f"{path}: {len(missing)} of {len(kit.images)} images not rated: "
                f"{_some(missing, ', ')}; finish them, or score what there is with --partial"
            )
    return everyone


def _record(line: bytes, kit: Kit) -> tuple[dict[str, Any], str | None]:
    try:
        record = json.loads(line)
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        return {}, f"not JSON: {error}"
    error = best_match(validator("expert-rating").iter_errors(record))
    if isinstance(error, ValidationError):
        field = ".".join(map(str, error.absolute_path))
        return record, f"{field}: {error.message}" if field else error.message
    if not math.isfinite(record["seconds"] or 0.0):
        return record, f"seconds: {record['seconds']}: give a time, or null"
    if record["kit"] != kit.digest:
        return record, f"kit {record['kit'][:12]}: these are ratings of another kit"
    return record, kit.fault(record["image"], record["view"], record["grade"])


def _refuse(where: str, faults: list[str]) -> None:
    if faults:
        raise RacinesError(f"{where}: {_some(faults, '; ')}")


def _some(items: list[str], between: str) -> str:
    more = f" and {len(items) - SHOWN} more" if len(items) > SHOWN else ""
    return between.join(items[:SHOWN]) + more


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
        # Two windows of one rater take turns.
        with locked(self.path.parent), self.path.open("a+b") as file:
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
        # A new file's name outlives a crash, as its content does; Windows opens no folder for that.
        if self._read == 0 and os.name == "posix":
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
