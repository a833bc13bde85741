"""The ceiling: the phantom itself, scanned again at the same pose with new electronic noise."""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.phantom.config import PHANTOM_VERSION, PhantomConfig, recorded_phantom
from racines_data.phantom.model import Phantom, shared_phantom
from racines_data.store.frames import FrameStore
from racines_models.generators.base import BaseGenerator
from racines_models.protocol import Run


@dataclass(frozen=True)
class NoiseCeilingConfig:
    """There is nothing to set: `fit` reads the phantom from the dataset's recipe."""

    phantom: PhantomConfig = PhantomConfig()
    """The phantom that was scanned, as it stands in the saved config."""


class NoiseCeiling(BaseGenerator[NoiseCeilingConfig]):
    """Scans the dataset's own phantom again: all that a pose can tell of the image.

    What is left between a frame and its second scan is electronic noise, multiple scattering and
    the error of the recorded pose, none of which a generator could know.
    """

    name = "noise-ceiling"
    Config = NoiseCeilingConfig
    title = "Noise ceiling"
    summary = "The phantom scanned again at the same pose, with new electronic noise."
    source = "a ceiling of this benchmark"
    stochastic = True
    trained = False
    limits = ("exists for simulated data only", "has seen no frame: it holds the scene itself")
    holds = ("phantom_version",)

    phantom: Phantom | None = None

    def learn(self, store: FrameStore, run: Run) -> dict[str, Any]:
        """Take the phantom that the dataset was acquired from; no image is looked at."""
        self.config = NoiseCeilingConfig(recorded_phantom(store.manifest))
        self.phantom = shared_phantom(self.config.phantom, self.device)
        # The rest stands in the config.
        self.held = {"phantom_version": torch.tensor([int(x) for x in PHANTOM_VERSION.split(".")])}
        return {"images": 0}

    def draw(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        """Scan the (B, 12) poses; a sample's seed draws its noise."""
        assert self.phantom is not None
        return self.phantom.generate(parameters, seed)

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Bake the phantom of the config again; refuse that of another version."""
        saved = ".".join(str(int(x)) for x in tensors["phantom_version"])
        if saved != PHANTOM_VERSION:
            raise RacinesError(f"it was made of phantom {saved}, this is phantom {PHANTOM_VERSION}")
        super().restore(tensors)
        self.phantom = shared_phantom(self.config.phantom, self.device)
