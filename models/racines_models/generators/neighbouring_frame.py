"""The bound of recorded turns: the real frame of the next turn, at the same phase of the beat.

It looks among all frames, those held out included, and leaves out the turn that is asked for. What
is drawn from training frames alone cannot be expected to be nearer to a frame than this is. It is
no method, and so not registered: name it `racines_models.generators.neighbouring_frame:Generator`.
"""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import parameters_to_pose
from racines_data.store.frames import FrameStore
from racines_models.generators.base import BaseGenerator
from racines_models.protocol import Run

SAME = 1e-6
"""Chord between two rotation matrices, below which they are of one turn."""
LATE = 1e4
"""Degrees that a beat weighs against an angle: a frame of the same phase is nearest."""
QUERIES = 64
"""Poses compared at a time."""


@dataclass(frozen=True)
class NeighbouringFrameConfig:
    """There is nothing to set."""


class Generator(BaseGenerator[NeighbouringFrameConfig]):
    """Returns the recorded frame of the nearest other turn; of equally near ones, the first."""

    name = "neighbouring-frame"
    Config = NeighbouringFrameConfig
    title = "Neighbouring frame"
    summary = "The real frame of the next turn, held out or not, at the same phase."
    source = "a bound of this benchmark"
    trained = False
    limits = ("knows held-out frames: a bound, no method", "draws nothing new")
    holds = ("turns", "phases", "images")

    def learn(self, store: FrameStore, run: Run) -> dict[str, Any]:
        """Remember all frames, of whatever split.

        Raises:
            RacinesError: the frames are not those of turns.
        """
        if store.turns is None:
            raise RacinesError(f"{self.name}: the dataset has no turns: import one of `rotation`")
        frames = store.take(torch.arange(len(store)))
        turns, phases = self._places(store.conditions(torch.arange(len(store))))
        held = {"turns": turns, "phases": phases, "images": frames.images}
        self.held = {name: tensor.to(self.device) for name, tensor in held.items()}
        return {"images": len(store)}

    def _places(self, parameters: Tensor) -> tuple[Tensor, Tensor]:
        """Return (B, 9) rotations and (B, 1) phases, 0 where the data know none, float64."""
        turns = parameters_to_pose(parameters[:, :12].double()).rotation.flatten(1)
        phases = parameters[:, 12:13].double() if self.phased else turns.new_zeros(len(turns), 1)
        return turns, phases

    def draw(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        """Return (B, 128, 128) frames of the next turns."""
        found = []
        for queries in parameters.split(QUERIES):
            turns, phases = self._places(queries)
            chord = torch.cdist(
                turns, self.held["turns"], compute_mode="donot_use_mm_for_euclid_dist"
            )
            cost = torch.rad2deg(2.0 * torch.asin((chord / 8.0**0.5).clamp_max(1.0)))
            off = (phases - self.held["phases"].T).abs()
            cost = cost + LATE * torch.minimum(off, 1.0 - off)
            found.append(cost.masked_fill(chord < SAME, torch.inf).argmin(1))
        return self.held["images"][torch.cat(found)]
