"""A sitting of the expert study as a page needs it: begin or resume, look, answer, leave.

A sitting is one visitor's; it holds names and a time, and the answers are on the disk. Each request
opens the session anew, so a page that is closed, or a second window, loses and doubles nothing.

Who begins under a name gets a code, and needs it to go on under that name. Of a code only its
SHA-256 is kept, `RATER.code` beside the ratings. The file is linked into place under its name,
which fails if there is one: of two people who begin at the same moment under the same name one gets
it, and neither ever writes into the other's answers.
"""

import hashlib
import hmac
import os
import secrets
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_leaderboard.expert.kit import KIT, Kit
from racines_leaderboard.expert.ratings import ABOUT, Session, check_rater, read_ratings
from racines_leaderboard.records.experts import EXPERT
from racines_leaderboard.studio.html import text, ultrasound
from racines_leaderboard.studio.inputs import choice, whole, words

KINDS = {"I try the page out": "trial", "I am an expert in echocardiography": EXPERT}
"""What a rater says to be, and the kind of the ratings; the first is the default."""
NAME, CODE = 32, 40
"""Longest name and longest code that is typed in, spaces and dashes included; characters."""
LETTERS = "abcdefghjkmnpqrstuvwxyz23456789"
"""Of codes: without those that are taken for one another."""
SLOWEST = 3600.0
"""A longer time to an answer is a break, and is not written down; seconds."""


@dataclass(frozen=True)
class Sitting:
    """One visitor at one kit, in front of one image."""

    kit: Path
    ratings: Path
    rater: str
    kind: str
    about: str
    code: str
    image: str | None = None
    """The image shown; None once all have an answer."""
    since: float = 0.0
    """When it was shown, by the monotonic clock."""
    done: int = 0
    total: int = 0


def kits(folder: Path | None) -> list[str]:
    """Return the names of the kits in a folder."""
    return sorted(path.parent.name for path in folder.glob(f"*/{KIT}")) if folder else []


def open_kit(folder: Path | None, name: Any) -> Kit:
    """Open a kit by its name; one that was not offered, or is damaged, is a `RacinesError`."""
    known = choice(name, kits(folder), "study")
    assert folder is not None
    return Kit.open(folder / known)


def begin(
    folder: Path | None, name: Any, rater: Any, kind: Any, about: Any, code: Any = ""
) -> Sitting:
    """Begin at a folder's kit under a new name, or go on under an old one with its code.

    Of `kind`, a key of `KINDS`, and `about`, what the report says of the rater, what was said at
    first holds.

    Raises:
        RacinesError: a field at fault, a name that is taken, or a wrong code.
    """
    kit = open_kit(folder, name)
    known_kind = KINDS[choice(kind, KINDS, "who you are")]
    rater = check_rater(words(rater, NAME, "name"), known_kind)
    about = words(about, ABOUT, "about you")
    code = words(code, CODE, "code")
    ratings = kit.folder.parent / f"{kit.folder.name}-ratings"
    if not code:
        code = _claim(ratings, rater)
    else:
        _check(ratings, rater, code)
        given = ratings / f"{rater}.jsonl"
        if given.is_file() and given.stat().st_size:
            first = read_ratings(given, kit)
            known_kind, about = first.kind, first.about
    return look(Sitting(kit.folder, ratings, rater, known_kind, about, code))


def _claim(ratings: Path, rater: str) -> str:
    """Take a name that nobody has, and return its code."""
    code = "-".join("".join(secrets.choice(LETTERS) for _ in range(4)) for _ in range(3))
    ratings.mkdir(parents=True, exist_ok=True)
    aside = ratings / f".{rater}.{secrets.token_hex(8)}"
    aside.write_text(_digest(code) + "\n", encoding="utf-8")
    try:
        if (ratings / f"{rater}.jsonl").exists():
            raise FileExistsError  # ratings of a program, or of a page that gave no code
        os.link(aside, ratings / f"{rater}.code")
    except FileExistsError as error:
        raise RacinesError(
            f"rater {rater}: the name is taken; give its code to go on, or choose another name"
        ) from error
    finally:
        aside.unlink()
    return code


def _check(ratings: Path, rater: str, code: str) -> None:
    """Refuse what is not the code of a name, and a name under which nobody has begun."""
    place = ratings / f"{rater}.code"
    kept = place.read_text(encoding="utf-8").strip() if place.is_file() else ""
    if not hmac.compare_digest(kept, _digest(code)):
        raise RacinesError(f"rater {rater}: that is not the code that this name was given here")


def _digest(code: str) -> str:
    plain = "".join(c for c in code.lower()[:CODE] if c in LETTERS)
    return hashlib.sha256(plain.encode()).hexdigest()


def look(sitting: Sitting) -> Sitting:
    """Return the sitting in front of its next image."""
    session = _session(sitting)
    image, now = session.next_image(), time.monotonic()
    return replace(sitting, image=image, since=now, **vars(session.progress()))


def answer(sitting: Sitting, view: Any, grade: Any) -> Sitting:
    """Write down an answer to the sitting's image, and go on to the next.

    The last of the kit's views stands for none and needs no grade. A choice that is missing, or was
    not offered, is a `RacinesError`.
    """
    if sitting.image is None:
        raise RacinesError("all images have an answer")
    session = _session(sitting)
    if session.next_image() != sitting.image:
        return look(sitting)  # it has an answer from another window of this rater
    labels, scale = session.kit.labels, session.kit.document["grades"]
    if view is None:
        raise RacinesError("choose the view first, or that there is none")
    view = choice(view, labels, "view")
    if view == labels[-1]:
        grade = scale["no_view"]
    elif grade is None:
        raise RacinesError("choose a grade")
    grade = whole(grade, min(scale["no_view"], scale["lowest"]), scale["highest"], "grade")
    seconds = time.monotonic() - sitting.since
    session.save(sitting.image, view, grade, seconds if seconds <= SLOWEST else None)
    return look(sitting)


def _session(sitting: Sitting) -> Session:
    return Session.open(sitting.kit, sitting.ratings, sitting.rater, sitting.kind, sitting.about)


def instructions_html(kit: Kit) -> str:
    """Return what a kit tells its raters."""
    document = kit.document
    views = ((text(view["name"]), text(view["title"])) for view in document["views"])
    listed = "".join(f"<li><strong>{name}</strong>, {title}</li>" for name, title in views)
    return (
        f'<div class="rc-note"><p>{text(document["preface"], 2000)}</p>'
        f"<p>{text(document['instructions'], 4000)}</p><ul>{listed}</ul></div>"
    )


def image_html(sitting: Sitting) -> str:
    """Return the image to be judged; its name is not shown, for the address tells nothing else."""
    if sitting.image is None:
        return ""
    png = Kit.open(sitting.kit).image_path(sitting.image).read_bytes()
    return ultrasound(png, f"image {sitting.done + 1} of {sitting.total}")


def progress_html(sitting: Sitting) -> str:
    """Return how far a rater is, in words and as a bar."""
    share = 100 * sitting.done / max(sitting.total, 1)
    progress = f"{sitting.done} of {sitting.total} images answered · {sitting.rater}"
    return (
        f'<div class="rc-note"><p>{text(progress)}</p>'
        f'<div class="rc-bar"><div style="width:{share:.1f}%"></div></div></div>'
    )


def code_html(sitting: Sitting) -> str:
    """Return the code with which a rater can go on another time."""
    return (
        '<p class="rc-note rc-code">To go on another time: name '
        f"<code>{text(sitting.rater)}</code>, code <code>{text(sitting.code)}</code>. "
        "Write both down; nobody can find the code again.</p>"
    )


def finished_html(sitting: Sitting) -> str:
    """Return thanks, and how the ratings are scored."""
    file = f"{sitting.ratings.name}/{sitting.rater}.jsonl"
    command = f"racines expert score {sitting.kit.name} {file}"
    return (
        f'<div class="rc-done"><p>All {sitting.total} images have an answer. Thank you.</p>'
        f"<p>The ratings are in <code>{text(file)}</code>; whoever holds the key scores them "
        f"with <code>{text(command)}</code>.</p></div>"
    )
