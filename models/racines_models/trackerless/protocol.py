"""What estimates motion, and where it is found: by name, `module:Class`, or a submission's file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self, runtime_checkable

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.plugins import Plugins
from racines_models.protocol import Run
from racines_models.provenance import weights_sha256
from racines_models.trackerless.motion import Motion
from racines_models.trackerless.sweeps import EVERY, Shown, SweepSet
from racines_models.training.checkpoint import repeat_folders

MOTIONS = Plugins(
    "motion estimator", "racines.motions", ("name", "Config", "trained", "estimate"),
    "module:Class, FILE.npz or FILE.parquet",
)  # fmt: skip
FILES = (".npz", ".parquet")
"""Endings of submissions."""
RUNS = Path("models/runs/motion")
"""Where what was trained lies, each in a folder of its name."""


@runtime_checkable
class MotionEstimator(Protocol):
    """Estimates the probe's motion along a sweep from its images.

    `Config` is a dataclass whose defaults are usable, filled from the section `motions.NAME`.
    """

    name: ClassVar[str]
    Config: ClassVar[type]
    trained: ClassVar[bool]
    """Whether it is `Learned`."""
    told_first: ClassVar[bool]
    """Whether it is told the sweep's first motion; only floors are."""

    def estimate(self, shown: Shown) -> Motion:
        """Return the motion of a sweep of T frames; the same images give the same motion."""
        ...


@runtime_checkable
class Learned(MotionEstimator, Protocol):
    """An estimator that learns from the train split."""

    learned_from: dict[str, Any]
    """What names the data, as `SweepSet.card`."""

    def __init__(self, config: Any = None) -> None:
        """Take a `Config`, or its defaults."""

    def fit(self, sweeps: SweepSet, run: Run) -> dict[str, Any]:
        """Learn, save into `run.folder`, and return the metrics."""
        ...

    @classmethod
    def load(cls, folder: Path, device: str = "cpu") -> Self:
        """Read what `fit` saved.

        Raises:
            RacinesError: there is no such model, or it is damaged.
        """
        ...


def is_submission(spec: str) -> bool:
    """Return whether a spec is a file, by its ending."""
    return Path(spec).suffix.lower() in FILES


def run_folder(name: str, folder: Path | None = None) -> Path:
    """Return the folder of a trained estimator: the one given, or that of its name."""
    return RUNS / name if folder is None else folder


def estimator_class(spec: str) -> type[Any]:
    """Return the class of a registered name or of `module:Class`, if it estimates motion."""
    return MOTIONS.load(spec)


def open_estimators(
    spec: str, folder: Path | None, settings: dict[str, Any], device: str = "cpu"
) -> list[Any]:
    """Return an estimator that a spec names, then its further trainings.

    Args:
        spec: a registered name, or `module:Class`.
        folder: of the run of one that is trained; None: that of its name.
        settings: of one that is not trained.
        device: where it runs.

    Raises:
        RacinesError: unknown, absent or refused, by name.
    """
    cls = estimator_class(spec)
    if not cls.trained:
        return [cls(fill(cls.Config, settings, f"motions.{cls.name}"))]
    first = run_folder(cls.name, folder)
    return [cls.load(each, device) for each in (first, *repeat_folders(first))]


def check_unseen(estimators: Sequence[Any], sweeps: SweepSet, split: str) -> None:
    """Refuse `all` splits of the data that an estimator learned from.

    Raises:
        RacinesError: with what to do.
    """
    digest = sweeps.card["digest"]
    if split == EVERY and any(
        (getattr(each, "learned_from", None) or {}).get("digest") == digest for each in estimators
    ):
        told = f"{estimators[0].name} learned from the train split of these data"
        raise RacinesError(f"{told}: give --split test")


def told_of(estimators: Sequence[Any], folder: Path | None) -> dict[str, Any]:
    """Return what a record says of an estimator and its trainings, whose run is in a folder."""
    first = estimators[0]
    told: dict[str, Any] = {key: bool(getattr(first, key)) for key in ("trained", "told_first")}
    if first.trained:
        run = run_folder(first.name, folder)
        hashes = weights_sha256(run)
        for each in repeat_folders(run):
            hashes |= {f"{each.name}/{file}": sha for file, sha in weights_sha256(each).items()}
        told |= {"weights": hashes or None, "learned_from": first.learned_from}
    return told
