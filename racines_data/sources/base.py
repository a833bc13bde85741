"""Where trajectories come from: the protocol of a source, and the registry of their names.

A source is one file with one class, and one entry point of the group `racines.sources`. The builder
makes it with `from_config`, asks for its `plan` and its `recipe`, and lets processes `produce` the
units: anywhere, in any order, always the same bytes. The source is pickled to each process once:
keep it small and build what is heavy (a baked volume, an opened file) on the first `produce`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, Self, runtime_checkable

from racines_data.plugins import Plugins
from racines_data.views import LABELS

if TYPE_CHECKING:
    from racines_data.schema import Trajectory

SOURCES = Plugins(
    "source",
    "racines.sources",
    ("name", "version", "Config", "from_config", "recipe", "plan", "produce"),
)


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
    say of its data is its `card`, a `racines_data.sources.card.SourceCard`.
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
    """Return the view labels of a source: its `labels` attribute, or the cardiac ones."""
    return tuple(getattr(source, "labels", LABELS))


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
