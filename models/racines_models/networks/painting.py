"""From frames to what networks see, from noise and pose to gray levels, and what is exported."""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from racines_data.imaging import IMAGE_SIZE
from racines_data.randomness import derive, normal
from racines_data.store.frames import FrameStore

CHUNK = 1024
"""Images looked at together."""


def to_range(images: Tensor) -> Tensor:
    """Turn (B, 128, 128) uint8 into (B, 1, 128, 128) float32 in [-1, 1]."""
    return images.unsqueeze(1).to(torch.float32) / 127.5 - 1.0


def to_gray(images: Tensor) -> Tensor:
    """Turn (B, 1, 128, 128) in [-1, 1] into (B, 128, 128) uint8."""
    return ((images.float() + 1.0) * 127.5).round().clamp(0, 255).to(torch.uint8).squeeze(1)


class Framed(nn.Module):
    """A network that draws, behind the stencil of the pixels that are black in every frame.

    Scan conversion leaves more than half of a sector image black. A network that has to learn this
    from its loss leaves a faint glow there, which costs more SSIM than what it draws wrongly.
    """

    lit: Tensor

    def __init__(self, network: Any):
        super().__init__()
        self.network = network
        self.noise: int = network.noise
        """Normal numbers that an image takes."""
        self.register_buffer("lit", torch.ones(1, 1, IMAGE_SIZE, IMAGE_SIZE))

    def fit(self, store: FrameStore) -> None:
        """Take the pixels that are not black in some image of the train split."""
        lit = torch.zeros(IMAGE_SIZE, IMAGE_SIZE, dtype=torch.bool)
        for rows in store.split_indices("train").split(CHUNK):
            lit |= store.take(rows).images.amax(0) > 0
        self.lit.copy_(lit)

    def forward(self, *inputs: Tensor) -> Tensor:
        """Return (B, 1, 128, 128) images in [-1, 1], -1 outside the frame."""
        return (self.network(*inputs) + 1.0) * self.lit - 1.0


class Painter(nn.Module):
    """A conditioning and a network `(latent, condition) -> (B, 1, 128, 128)` in [-1, 1]."""

    def __init__(self, conditioning: nn.Module, network: nn.Module):
        super().__init__()
        self.conditioning, self.network = conditioning, network

    def forward(self, parameters: Tensor, noise: Tensor) -> Tensor:
        """Return (B, 128, 128) uint8 of (B, 12) parameters and (B, latent) noise."""
        return to_gray(self.network(noise, self.conditioning(parameters)))


@dataclass(frozen=True)
class NoiseInput:
    """Standard normal noise of a sample: `normal(derive(seed, *keys), size)`."""

    size: int
    """Numbers a sample."""
    keys: tuple[int, ...] = ()
    """Keys that the generator derives its own random stream with, from the sample's seed."""

    def draw(self, seeds: Tensor) -> Tensor:
        """Return (B, size) float32 noise of (B,) int64 seeds."""
        return normal(derive(seeds, *self.keys), self.size)


@dataclass(frozen=True)
class OnnxModule:
    """A network that draws, without Python around it.

    `network(parameters)` or, with noise, `network(parameters, noise)` takes (B, 12) float32
    parameters, whose forces may be NaN, and (B, size) float32 noise; it returns (B, 128, 128) uint8
    gray levels. It must be traceable by `torch.export` with any B.
    """

    network: nn.Module
    noise: NoiseInput | None = None
    """None: the image follows from the pose alone."""
