"""What a source says of its data: the texts of the card, of Croissant and of the datasheet.

A source names its `SourceCard` as the class attribute `card`. The manifest of a dataset of another
package's source holds it too, so that the dataset is described where that package is not installed.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from racines_data.errors import RacinesError
from racines_data.schema import SOURCES as OURS
from racines_data.sources.base import SOURCES

_OTHER = "A source of another package; see its documentation."


@dataclass(frozen=True)
class SourceCard:
    """What there is to know of a source's data; each text is one or more whole sentences."""

    origin: str = "a source of another package"
    """Where the frames come from, in half a sentence: it stands first on the card."""
    license: str = "other"
    """Identifier on a hub, e.g. `cc-by-4.0`."""
    rights: str = "As its source says."
    """The licence in a sentence."""
    tags: tuple[str, ...] = ()
    """Tags on a hub, beside those that every dataset has."""
    simulated: bool = False
    """Whether a machine made frames and labels."""
    labelled: bool = True
    """Whether there are views."""
    like_paper: bool = False
    """Whether the paper's statistics are the measure of a heart's frames."""
    collection: str = _OTHER
    """How the frames were acquired."""
    collection_type: str = "Others"
    """A term of Croissant's vocabulary."""
    annotation: str = _OTHER
    """How views and grades came about."""
    biases: str = _OTHER
    limitations: str = _OTHER
    """What limits the use, in the datasheet."""
    personal: str = _OTHER
    """Whether there is personal information."""
    limits: str = "See the source."
    """What limits the use, on the card."""


def manifest_card(manifest: Mapping[str, Any]) -> SourceCard:
    """Return the card of a dataset's source: the manifest's, the source's, or a neutral one.

    Of the manifest, `source` is enough.
    """
    if held := manifest.get("card"):
        known = {field.name for field in fields(SourceCard)}
        given = {key: value for key, value in held.items() if key in known}
        return SourceCard(**{**given, "tags": tuple(given.get("tags", ()))})
    try:
        return getattr(SOURCES.load(manifest["source"]), "card", None) or SourceCard()
    except RacinesError:  # not installed, or broken: the data are there all the same
        return SourceCard()


def own_card(source: Any) -> SourceCard | None:
    """Return the card that a dataset has to hold itself; None for our sources, which are there."""
    return None if source.name in OURS else getattr(source, "card", None)
