"""The one place that says where published weights are, from whichever folder one works.

Those of the current folder count first, then those of the checkout whose code this is. A wheel
carries a few of them: a judge and two agents.
"""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

from racines_data.terminal import note

WEIGHTS = Path("models/weights")
POLICIES = Path("envs/weights")
CHECKOUT = Path(__file__).resolve().parents[3]
"""The folder of the checkout that this code lies in; of an installed wheel, one without weights."""
CARRIED = Path(__file__).resolve().with_name("carried")
"""What an installed wheel has of a checkout's weights; absent from a checkout."""


def published(folder: Path) -> Path:
    """Return where a published folder or file, such as `models/weights/grader`, lies.

    The path as it is, if it is there or nowhere; or else the same of the checkout or the wheel.
    """
    places = (folder, CHECKOUT / folder, CARRIED / folder)
    return next((place for place in places if place.exists()), folder)


def of_weights(folder: Path) -> Path:
    """Return where a folder lies that may be one of `models/weights`; any other as it is."""
    return published(folder) if folder.is_relative_to(WEIGHTS) else folder


def own_or_published(own: Path, folders: Path | Sequence[Path], file: str) -> Path:
    """Return the folder that has a file: a run made here stands before the published ones.

    Of several published ones the first that is here counts. The first time that one is taken it is
    said on stderr. Where none has the file the folder of the run is returned.
    """
    if (own / file).is_file():
        return own
    for folder in [folders] if isinstance(folders, Path) else folders:
        there = published(folder)
        if (there / file).is_file():
            _tell(own, there)
            return there
    return own


@cache
def _tell(own: Path, there: Path) -> None:
    """Say once a process which weights stand in for a run."""
    note(f"racines: no {own} here: using the published {there}")
