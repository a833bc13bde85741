"""Where trajectories come from: the protocol of a source, its card, the registry of their names.

A source is one file with one class, and one entry point of the group `racines.sources`. The builder
makes it with `from_config`, asks for its `plan` and its `recipe`, and lets processes `produce` the
units: anywhere, in any order, always the same bytes. The source is pickled to each process once:
keep it small and build what is heavy (a baked volume, an opened file) on the first `produce`.

What a source says of its data is its class attribute `card`, for the dataset's card, Croissant and
the datasheet. The manifest of a dataset of another package's source holds it too, so that the
dataset is described where that package is not installed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, Self, runtime_checkable

from racines_data.errors import RacinesError
from racines_data.plugins import Plugins
from racines_data.views import LABELS, check_labels

if TYPE_CHECKING:
    from racines_data.schema import Trajectory

SOURCES = Plugins(
    "source",
    "racines.sources",
    ("name", "version", "Config", "from_config", "recipe", "plan", "produce"),
)
_OTHER = "A source of another package; see its documentation."
PROJECT = "The RACINES developers"
"""Who made what this project's own sources simulate."""
NOT_TOLD = "unknown (not told)"
"""Stands where a name would, of recordings whose makers nobody told."""
SIMULATED = ("phantom", "patients", "beating")


@dataclass(frozen=True)
class Unit:
    """One trajectory to be made. Subclass it to carry what `produce` needs; keep it small."""

    id: str
    """Name of the trajectory, unique in the dataset."""
    session: str
    """Name of the recording session."""
    target_view: str
    """One of the source's views, or `Random` where there was no target."""
    frames: int
    """Number of frames expected; it balances the work and drives the progress bar."""


@dataclass(frozen=True)
class Finding:
    """One input that was refused, or kept and flagged, with the reason."""

    file: str
    item: str
    """The frame or field, empty for the whole file."""
    refused: bool
    reason: str
    frames: int = 1
    """Number of frames concerned."""


@runtime_checkable
class Source(Protocol):
    """Yields trajectories. Must be picklable.

    A source of other views than the five also has `labels: tuple[str, ...]`, `Random` last. One of
    single images, without poses and times, has `poses = False`; both are then NaN. What there is to
    say of its data is its `card`, a `SourceCard`.

    A source that knows to which split a trajectory belongs gives its units a `split`; one that has
    more to say of the whole has a dictionary `told`, which the manifest then holds, once planned.

    A source whose config stands beside those of a dataset that is there, and does not take its
    place, names that config as `adds`; see `racines_data.build.beside`.
    """

    name: str
    """Name in the registry, the card and the `source` column."""
    version: str
    """Semantic version of the dataset that this source makes, x.y.z."""
    report: list[Finding]
    """Filled by `plan`; empty where there is nothing to say."""
    Config: ClassVar[type]
    """Dataclass of settings. Fields `frames` and `seed`, if any, are set from the data section."""

    @classmethod
    def from_config(cls, config: dict[str, Any], inputs: Sequence[Path]) -> Self:
        """Make the source from its settings and input files.

        Raises:
            RacinesError: an unknown or wrong setting, or an input that is missing or not wanted.
        """
        ...

    def recipe(self) -> dict[str, Any]:
        """Return all that decides the bytes, JSON-able: versions, settings, inputs' sha256."""
        ...

    def plan(self) -> Sequence[Unit]:
        """Return the units in the order of the dataset; the same list every time."""
        ...

    def produce(self, unit: Unit) -> "Trajectory":
        """Make one trajectory: equal bytes whichever process makes it, in whatever order.

        Its id, session and target view are the unit's.
        """
        ...


def labels_of_source(source: Source) -> tuple[str, ...]:
    """Return the view labels of a source: its `labels` attribute, or the cardiac ones.

    Raises:
        RacinesError: one cannot be part of a file's name.
    """
    return check_labels(getattr(source, "labels", LABELS), f"source {source.name}: labels")


def has_poses(source: Source) -> bool:
    """Return whether the frames of a source have poses and times."""
    return bool(getattr(source, "poses", True))


def source_names() -> tuple[str, ...]:
    """Return the names of the sources that installed packages register, sorted."""
    return SOURCES.names()


def source_class(name: str) -> type[Source]:
    """Return the class of a source by its name, or by `module:Class`.

    Raises:
        RacinesError: no such source, or it cannot be imported.
    """
    return SOURCES.load(name)


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
    attribution: str = ""
    """Who made the frames, and where they are published; empty where nobody told."""


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


def held_card(card: SourceCard | None) -> dict[str, Any] | None:
    """Return a card as a manifest holds it; without attribution where nobody told one."""
    return card and {key: value for key, value in asdict(card).items()
                     if value or key != "attribution"}  # fmt: skip


def maker_of(manifest: Mapping[str, Any]) -> str:
    """Return who made the frames: whom the card names, this project for what it simulates itself.

    Recordings are never the project's: where nobody told whose they are, that is what is said.
    """
    card = manifest_card(manifest)
    return card.attribution or (PROJECT if is_own(card, manifest["source"]) else NOT_TOLD)


def is_own(card: SourceCard, source: str) -> bool:
    """Return whether this project itself simulates the frames of a source."""
    return card.simulated and source in SIMULATED


def rights_of(manifest: Mapping[str, Any]) -> dict[str, str]:
    """Return licence, rights, maker and what is said of persons: what every export carries."""
    card = manifest_card(manifest)
    rights = {"license": card.license, "rights": card.rights, "personal": card.personal}
    return rights | {"attribution": maker_of(manifest)}


def own_card(source: Any) -> SourceCard | None:
    """Return the card that a dataset has to hold itself; None for our sources, which are there.

    One of ours that scans a phantom of one's own has a card of its own, too.
    """
    from racines_data.schema import SOURCES as OURS

    if source.name in OURS:
        return None if isinstance(source, type) else vars(source).get("card")
    return getattr(source, "card", None)


def card_with(card: SourceCard, own: Mapping[str, Any]) -> SourceCard:
    """Return a simulated source's card for a phantom of one's own: `provenance` of it."""
    made = f"The anatomy is {own['name']}, a phantom of one's own ({own['digest'][:12]}…): "
    made += f"{own['source'] or 'its source is not said'}. "
    added = "".join(f"Synthetic, in no file of its source: {name}: {why}. "
                    for name, why in own["synthetic"].items())  # fmt: skip
    rights = f"{card.rights} The anatomy: {own['licence'] or 'licence not said'}."
    return replace(
        card,
        rights=rights,
        collection=made + added + card.collection,
        biases=f"One organ: {own['name']}. {card.biases}",
        limits=f"{added}{card.limits}",
        like_paper=False,
    )
