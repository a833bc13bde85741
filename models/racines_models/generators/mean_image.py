"""The floor: the mean of all training images, whatever the pose; of a beat, at each phase."""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from racines_data.store.frames import FrameStore
from racines_models.generators.base import BaseGenerator
from racines_models.networks.painting import OnnxModule
from racines_models.protocol import Run

MOST = 32
"""Phases with a mean of their own; more are told apart to so many parts of a beat."""


@dataclass(frozen=True)
class MeanImageConfig:
    """There is nothing to set."""


class MeanImage(BaseGenerator[MeanImageConfig]):
    """Returns one image for every pose: what a score costs without looking at the pose.

    Where the data know the phase of the beat, it is the mean of the frames at the nearest phase.
    """

    name = "mean-image"
    Config = MeanImageConfig
    title = "Mean image"
    summary = "The mean of the training images, the same for every pose."
    source = "a floor of this benchmark"
    conditional = False
    trained = False
    limits = ("ignores the pose",)

    def learn(self, store: FrameStore, run: Run) -> dict[str, Any]:
        """Average the train split, exactly (integer sums)."""
        frames = store.split_indices("train")
        if not self.phased:
            self.held = {"image": _mean(store, frames).to(self.device)}
            return {"images": len(frames)}
        phases = store.conditions(frames)[:, -1]
        known = phases.unique()
        if len(known) > MOST:
            known = torch.arange(MOST) / MOST
        nearest = _nearest(phases, known)
        used = [place for place in range(len(known)) if bool((nearest == place).any())]
        means = [_mean(store, frames[nearest == place]) for place in used]
        held = {"image": torch.stack(means), "phases": known[used]}
        self.held = {name: each.to(self.device) for name, each in held.items()}
        return {"images": len(frames)}

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Take back the mean, or the means and their phases."""
        names = ("image", "phases") if self.phased else ("image",)
        self.held = {name: tensors[name] for name in names}

    def draw(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        """Return (B, 128, 128) copies of the mean, of that at the nearest phase."""
        image = self.held["image"]
        if not self.phased:
            return image.repeat(len(parameters), 1, 1)
        return image[_nearest(parameters[:, -1], self.held["phases"])]

    def onnx_module(self) -> OnnxModule:
        """Return a network that repeats the mean."""
        if self.phased:
            return OnnxModule(_OfBeat(self.held["image"], self.held["phases"]))
        return OnnxModule(_Repeat(self.held["image"]))


def _mean(store: FrameStore, frames: Tensor) -> Tensor:
    """Return the (128, 128) uint8 mean of some rows."""
    total = torch.zeros(store.images.shape[1:], dtype=torch.int64)
    for chunk in frames.split(1024):
        total += store.take(chunk).images.sum(0, dtype=torch.int64)
    return (total.double() / len(frames)).round().to(torch.uint8)


def _nearest(phases: Tensor, known: Tensor) -> Tensor:
    """Return the (B,) place among (P,) known phases that is nearest on the circle to each."""
    apart = (phases.unsqueeze(1) - known).abs()
    return torch.minimum(apart, 1.0 - apart).argmin(1)


class _Repeat(nn.Module):
    image: Tensor

    def __init__(self, image: Tensor):
        super().__init__()
        self.register_buffer("image", image)

    def forward(self, parameters: Tensor) -> Tensor:
        return self.image.expand(len(parameters), -1, -1)


class _OfBeat(nn.Module):
    image: Tensor
    phases: Tensor

    def __init__(self, image: Tensor, phases: Tensor):
        super().__init__()
        self.register_buffer("image", image)
        self.register_buffer("phases", phases)

    def forward(self, parameters: Tensor) -> Tensor:
        return self.image[_nearest(parameters[:, -1], self.phases)]
