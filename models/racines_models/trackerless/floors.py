"""Floors of motion: what is estimated without a look at any image."""

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.files import write_json
from racines_models.protocol import Run
from racines_models.provenance import code_version
from racines_models.trackerless.motion import Motion, steps, to_vectors
from racines_models.trackerless.sweeps import Shown, SweepSet
from racines_models.weights import read_described

SCHEMA = "racines.mean-motion/1"
CONFIG = "config.json"
SIX = "shift x, y, z in m and rotation vector x, y, z in rad, from a frame to the one before"


def _repeated(vector: Tensor, shown: Shown) -> Motion:
    return steps(vector.double().expand(len(shown.images) - 1, 6))


@dataclass(frozen=True)
class NoMotionConfig:
    """It has no settings."""


class NoMotion:
    """The probe rests: TUS-REC's largest error."""

    name: ClassVar[str] = "no-motion"
    Config: ClassVar[type] = NoMotionConfig
    trained: ClassVar[bool] = False
    told_first: ClassVar[bool] = False

    def __init__(self, config: NoMotionConfig | None = None) -> None:
        """Take settings, of which there are none."""

    def estimate(self, shown: Shown) -> Motion:
        """Return the identity for every frame."""
        return _repeated(torch.zeros(6), shown)


@dataclass(frozen=True)
class ConstantMotionConfig:
    """How the probe moves."""

    prior: tuple[float, ...] = ()
    """Six numbers: shift x, y, z in m and rotation vector x, y, z in rad, from a frame to the one
    before. Empty: the sweep's own first motion, which it is then told."""


class ConstantMotion:
    """The probe moves on as it began, or as a prior says."""

    name: ClassVar[str] = "constant-motion"
    Config: ClassVar[type] = ConstantMotionConfig
    trained: ClassVar[bool] = False

    def __init__(self, config: ConstantMotionConfig | None = None) -> None:
        """Take settings.

        Raises:
            RacinesError: a prior of other than six numbers.
        """
        self.config = config or ConstantMotionConfig()
        if len(self.config.prior) not in (0, 6):
            given = len(self.config.prior)
            raise RacinesError(f"motions.constant-motion.prior: {given} numbers: give six: {SIX}")
        self.told_first = not self.config.prior

    def estimate(self, shown: Shown) -> Motion:
        """Return the same step for every frame."""
        if self.config.prior:
            return _repeated(torch.tensor(self.config.prior, dtype=torch.float64), shown)
        assert shown.first is not None
        return _repeated(to_vectors(shown.first), shown)


@dataclass(frozen=True)
class MeanMotionConfig:
    """What was learned is six numbers; `fit` finds them."""

    step: tuple[float, ...] = field(default=(0.0,) * 6)


class MeanMotion:
    """The probe moves as the training sweeps do on average."""

    name: ClassVar[str] = "mean-motion"
    Config: ClassVar[type] = MeanMotionConfig
    trained: ClassVar[bool] = True
    told_first: ClassVar[bool] = False

    def __init__(self, config: MeanMotionConfig | None = None) -> None:
        """Take the mean step."""
        self.config = config or MeanMotionConfig()
        self.learned_from: dict[str, Any] = {}

    def fit(self, sweeps: SweepSet, run: Run) -> dict[str, Any]:
        """Average the six numbers of all steps of the train split; chance plays no part."""
        _, motions = sweeps.steps("train")
        self.config = MeanMotionConfig(tuple(motions.mean(0).tolist()))
        self.learned_from = dict(sweeps.card)
        metrics = {"steps": len(motions), "step": list(self.config.step)}
        made = {"schema": SCHEMA, "name": self.name, "config": asdict(self.config)}
        made |= {"data": sweeps.card, "code": code_version(), "training": metrics}
        write_json(run.folder / CONFIG, made)
        return {"name": self.name, "data": sweeps.card, **metrics}

    @classmethod
    def load(cls, folder: Path, device: str = "cpu") -> "MeanMotion":
        """Read what `fit` saved; `device` is of no effect.

        Raises:
            RacinesError: nothing was saved there, or not six numbers.
        """
        absent = "no mean motion there; run: racines train motion mean-motion"
        described = read_described(folder, absent, SCHEMA)
        config = described.get("config", {})
        found = cls(fill(MeanMotionConfig, config, f"{folder / CONFIG}: config"))
        found.learned_from = described.get("data") or {}
        if len(found.config.step) != 6:
            raise RacinesError(f"{folder / CONFIG}: config.step: give six numbers: {SIX}")
        return found

    def estimate(self, shown: Shown) -> Motion:
        """Return the same step for every frame."""
        return _repeated(torch.tensor(self.config.step, dtype=torch.float64), shown)
