"""Ratings: one JSON Lines file a rater, a line an answer, appended and never rewritten.

A line stands by itself: it names its kit and its rater. A last line without its end is what a
crash left of an answer that was never acknowledged; readers leave it out.
"""

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jsonschema.exceptions import ValidationError, best_match

from racines_data.errors import RacinesError
from racines_leaderboard.expert.kit import Kit
from racines_leaderboard.records.experts import KINDS, MACHINES
from racines_leaderboard.records.schema import validator

SCHEMA = "racines.ratings/1"
RATER = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
LONGEST = 32
SHOWN = 10
"""Most faults named at once."""


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
