"""Resume codes: who begins a study under a name gets one, and needs it to go on under that name.

Of a code only its SHA-256 is kept, `RATER.code` beside the ratings. The file is linked into place
under its name, which fails if there is one: of two people who begin at the same moment under the
same name one gets it, and neither ever writes into the other's answers.
"""

import hashlib
import hmac
import os
import secrets
from pathlib import Path

from racines_data.errors import RacinesError

LETTERS = "abcdefghjkmnpqrstuvwxyz23456789"
"""Without those that are taken for one another."""
GROUPS, GROUP = 3, 4
LONGEST = 40
"""Characters of what is typed in, spaces and dashes among them."""


def claim(ratings: Path, rater: str) -> str:
    """Take a name that nobody has, and return its code.

    Raises:
        RacinesError: the name is taken.
    """
    code = "-".join("".join(secrets.choice(LETTERS) for _ in range(GROUP)) for _ in range(GROUPS))
    ratings.mkdir(parents=True, exist_ok=True)
    aside = ratings / f".{rater}.{secrets.token_hex(8)}"
    aside.write_text(_digest(code) + "\n")
    try:
        if (ratings / f"{rater}.jsonl").exists():
            raise FileExistsError  # ratings of a program, or of a page that gave no code
        os.link(aside, _place(ratings, rater))
    except FileExistsError as error:
        raise RacinesError(
            f"rater {rater}: the name is taken; give its code to go on, or choose another name"
        ) from error
    finally:
        aside.unlink()
    return code


def check(ratings: Path, rater: str, code: str) -> None:
    """Check that a code is that of a name.

    Raises:
        RacinesError: it is not, or nobody has begun under the name.
    """
    place = _place(ratings, rater)
    kept = place.read_text().strip() if place.is_file() else ""
    if not hmac.compare_digest(kept, _digest(code)):
        raise RacinesError(f"rater {rater}: that is not the code that this name was given here")


def _place(ratings: Path, rater: str) -> Path:
    return ratings / f"{rater}.code"


def _digest(code: str) -> str:
    plain = "".join(c for c in code.lower()[:LONGEST] if c in LETTERS)
    return hashlib.sha256(plain.encode()).hexdigest()
