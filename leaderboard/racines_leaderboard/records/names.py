"""Names and hashes that stand for one thing alone: none that looks like another, none made up."""

import hashlib
import re
import unicodedata
from collections.abc import Iterable

from racines_data.errors import RacinesError

SEPARATORS = re.compile(r"[\s._-]+")
LOOKALIKES = str.maketrans({"i": "1", "l": "1", "|": "1", "o": "0"})
EMPTY = {hashlib.sha256(content).hexdigest() for content in (b"", b"\n", b"\x00")}
"""Digests of files that hold nothing."""


def skeleton(name: str) -> str:
    """Return what names that look alike share.

    Case and Unicode form are folded (NFKC, then casefold), separators left out, and 1, i and l made
    one, as are 0 and o: the Python Package Index compares the names of projects so.
    """
    folded = unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", name).casefold())
    return SEPARATORS.sub("", folded).translate(LOOKALIKES)


def check_unlike(name: str, others: Iterable[str], where: str) -> None:
    """Refuse a name that looks like one of the others without being it."""
    told = skeleton(name)
    for other in others:
        if other != name and skeleton(other) == told:
            raise RacinesError(f"{where}: {name!r} looks like {other!r}: choose another name")


def made_up(digest: str) -> bool:
    """Return whether a digest is a placeholder: of an empty file, or one pattern repeated."""
    size = len(digest)
    periods = (each for each in range(1, size // 2 + 1) if size % each == 0)
    return digest in EMPTY or any(digest == digest[:each] * (size // each) for each in periods)


def check_hash(digest: str, where: str) -> None:
    """Refuse a digest that is a placeholder."""
    if made_up(digest):
        short = f"{digest[:12]}…" if len(digest) > 12 else digest
        raise RacinesError(f"{where}: {short} is a placeholder: write the digest of what it names")
