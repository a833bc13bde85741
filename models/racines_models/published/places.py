"""The one place that says where published weights are, from whichever folder one works.

They come with a checkout and not with a wheel: those of the current folder count first, then those
of the checkout whose code this is.
"""

from functools import cache
from pathlib import Path

from racines_data.terminal import note

WEIGHTS = Path("models/weights")
POLICIES = Path("envs/weights")
CHECKOUT = Path(__file__).resolve().parents[3]
"""The folder of the checkout that this code lies in; of an installed wheel, one without weights."""


def published(folder: Path) -> Path:
    """Return where a published folder or file, such as `models/weights/grader`, lies.

    The path as it is, if it is there or nowhere; or else the same of the checkout.
    """
    there = CHECKOUT / folder
    return there if not folder.exists() and there.exists() else folder


def own_or_published(own: Path, folder: Path, file: str) -> Path:
    """Return the folder that has a file: a run made here stands before the published one.

    The first time that the published one is taken it is said on stderr. Where neither has the file
    the folder of the run is returned.
    """
    there = published(folder)
    if (own / file).is_file() or not (there / file).is_file():
        return own
    _tell(own, there)
    return there


@cache
def _tell(own: Path, there: Path) -> None:
    """Say once a process which weights stand in for a run."""
    note(f"racines: no {own} here: using the published {there}")
