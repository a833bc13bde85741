"""The floor: the mean of all training images, whatever the pose."""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from racines_data.store.frames import FrameStore
from racines_models.generators.base import BaseGenerator
from racines_models.networks.painting import OnnxModule
from racines_models.protocol import Run


@dataclass(frozen=True)
class MeanImageConfig:
    """There is nothing to set."""


class MeanImage(BaseGenerator[MeanImageConfig]):
    """Returns one image for every pose: what a score costs without looking at the pose."""

    name = "mean-image"
    Config = MeanImageConfig
    title = "Mean image"
    summary = "The mean of the training images, the same for every pose."
    source = "a floor of this benchmark"
    conditional = False
    trained = False
    limits = ("ignores the pose",)
    holds = ("image",)

    def learn(self, store: FrameStore, run: Run) -> dict[str, Any]:
        """Average the train split in one pass, exactly (integer sums)."""
        total = torch.zeros(store.images.shape[1:], dtype=torch.int64)
        frames = store.split_indices("train")
        for chunk in frames.split(1024):
            total += store.take(chunk).images.sum(0, dtype=torch.int64)
        mean = total.double() / len(frames)
        self.held = {"image": mean.round().to(device=self.device, dtype=torch.uint8)}
        return {"images": len(frames)}

    def draw(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        """Return (B, 128, 128) copies of the mean."""
        return self.held["image"].repeat(len(parameters), 1, 1)

    def onnx_module(self) -> OnnxModule:
        """Return a network that repeats the mean."""
        return OnnxModule(_Repeat(self.held["image"]))


class _Repeat(nn.Module):
    image: Tensor

    def __init__(self, image: Tensor):
        super().__init__()
        self.register_buffer("image", image)

    def forward(self, parameters: Tensor) -> Tensor:
        return self.image.expand(len(parameters), -1, -1)
