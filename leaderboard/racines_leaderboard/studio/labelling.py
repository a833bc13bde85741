"""A sitting of the expert study as a page needs it: begin or resume, look, answer, leave.

A sitting is one visitor's; it holds names and a time, and the answers are on the disk. Each request
opens the session anew, so a page that is closed, or a second window, loses and doubles nothing.
"""

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_leaderboard.expert.kit import KIT, Kit
from racines_leaderboard.expert.ratings import check_rater, read_ratings
from racines_leaderboard.expert.session import ABOUT, Session
from racines_leaderboard.records.names import EXPERT
from racines_leaderboard.studio import codes
from racines_leaderboard.studio.html import text
from racines_leaderboard.studio.inputs import choice, whole, words
from racines_leaderboard.studio.pictures import ultrasound

KINDS = {"I try the page out": "trial", "I am an expert in echocardiography": EXPERT}
"""What a rater says to be, and the kind of the ratings; the first is the default."""
NAME = 32
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
    if folder is None:
        return []
    return sorted(path.parent.name for path in folder.glob(f"*/{KIT}"))


def open_kit(folder: Path | None, name: Any) -> Kit:
    """Open a kit by its name.

    Raises:
        RacinesError: no such kit, or a damaged one.
    """
    known = choice(name, kits(folder), "study")
    assert folder is not None
    return Kit.open(folder / known)


def begin(
    folder: Path | None, name: Any, rater: Any, kind: Any, about: Any, code: Any = ""
) -> Sitting:
    """Begin under a new name, or go on under an old one with its code.

    Args:
        folder: The folder of the kits.
        name: Of the kit.
        rater: A pseudonym.
        kind: A key of `KINDS`; with a code, what was said at first holds.
        about: What the report says of the rater; likewise.
        code: The code that the name was given; empty to begin.

    Raises:
        RacinesError: a field at fault, a name that is taken, or a wrong code.
    """
    kit = open_kit(folder, name)
    known_kind = KINDS[choice(kind, KINDS, "who you are")]
    rater = check_rater(words(rater, NAME, "name"), known_kind)
    about = words(about, ABOUT, "about you")
    code = words(code, codes.LONGEST, "code")
    ratings = kit.folder.parent / f"{kit.folder.name}-ratings"
    if not code:
        code = codes.claim(ratings, rater)
    else:
        codes.check(ratings, rater, code)
        known_kind, about = _said_at_first(kit, ratings / f"{rater}.jsonl") or (known_kind, about)
    return look(Sitting(kit.folder, ratings, rater, known_kind, about, code))


def look(sitting: Sitting) -> Sitting:
    """Return the sitting in front of its next image."""
    session = _session(sitting)
    progress = session.progress()
    return replace(
        sitting,
        image=session.next_image(),
        since=time.monotonic(),
        done=progress.done,
        total=progress.total,
    )


def answer(sitting: Sitting, view: Any, grade: Any) -> Sitting:
    """Write down an answer to the image that is shown, and go on to the next.

    Args:
        sitting: Its `image` is answered.
        view: A name of the kit's views; the last needs no grade.
        grade: 1 to 10; ignored where there is no view.

    Raises:
        RacinesError: no view or grade chosen, or none that was offered.
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


def _said_at_first(kit: Kit, path: Path) -> tuple[str, str] | None:
    """Return a rater's kind and description as the ratings have them; None before the first."""
    if not path.is_file() or not path.stat().st_size:
        return None
    known = read_ratings(path, kit)
    return known.kind, known.about


def _session(sitting: Sitting) -> Session:
    return Session.open(sitting.kit, sitting.ratings, sitting.rater, sitting.kind, sitting.about)


def instructions_html(kit: Kit) -> str:
    """Return what a kit tells its raters."""
    document = kit.document
    views = "".join(
        f"<li><strong>{text(view['name'])}</strong>, {text(view['title'])}</li>"
        for view in document["views"]
    )
    return (
        f'<div class="rc-note"><p>{text(document["preface"], 2000)}</p>'
        f"<p>{text(document['instructions'], 4000)}</p><ul>{views}</ul></div>"
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
