"""The frame of the picture: pixels that are black in every training image stay black."""

import torch
from torch import Tensor, nn

from racines_data.imaging import IMAGE_SIZE
from racines_data.store.frames import FrameStore

CHUNK = 1024
"""Images looked at together."""


class Framed(nn.Module):
    """A network that draws, behind the sector's stencil.

    Scan conversion leaves more than half of a sector image black. A network that has to learn this
    from its loss leaves a faint glow there, which costs more SSIM than what it draws wrongly.
    """

    lit: Tensor

    def __init__(self, network: nn.Module):
        super().__init__()
        self.network = network
        self.register_buffer("lit", torch.ones(1, 1, IMAGE_SIZE, IMAGE_SIZE))

    @property
    def noise(self) -> int:
        """Normal numbers that an image takes."""
        noise = self.network.noise
        assert isinstance(noise, int)
        return noise

    def fit(self, store: FrameStore) -> "Framed":
        """Take the pixels that are not black in some image of the train split."""
        lit = torch.zeros(IMAGE_SIZE, IMAGE_SIZE, dtype=torch.bool)
        for rows in store.split_indices("train").split(CHUNK):
            lit |= store.take(rows).images.amax(0) > 0
        self.lit.copy_(lit)
        return self

    def forward(self, *inputs: Tensor) -> Tensor:
        """Return (B, 1, 128, 128) images in [-1, 1], -1 outside the frame."""
        return (self.network(*inputs) + 1.0) * self.lit - 1.0
