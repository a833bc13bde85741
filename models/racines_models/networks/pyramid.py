"""Latent and condition to image: one pyramid of layers for every GAN of the paper but StyleGAN."""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate, relu

from racines_models.networks.layers import (
    BOTTOM,
    ConditionalBatchNorm,
    ConditionEmbedding,
    attending,
    bottom_features,
    initialise,
    through,
    widths,
)


class PlainUp(nn.Module):
    """Doubles the side: deconvolution, conditional norm, ReLU (DCGAN)."""

    def __init__(self, before: int, after: int, embedding: int):
        super().__init__()
        self.conv = nn.ConvTranspose2d(before, after, 4, stride=2, padding=1, bias=False)
        self.norm = ConditionalBatchNorm(after, embedding)

    def forward(self, maps: Tensor, embedded: Tensor | None) -> Tensor:
        """Return (B, after, 2H, 2W) maps."""
        return relu(self.norm(self.conv(maps), embedded))


class ResidualUp(nn.Module):
    """Doubles the side: two normed convolutions beside a 1×1 shortcut.

    Source: He et al., Identity Mappings in Deep Residual Networks, 2016 (norm and ReLU first);
    upsampling as in Miyato et al., Spectral Normalization for GANs, 2018, appendix B.
    """

    def __init__(self, before: int, after: int, embedding: int):
        super().__init__()
        self.norm_in = ConditionalBatchNorm(before, embedding)
        self.conv_in = nn.ConvTranspose2d(before, after, 4, stride=2, padding=1, bias=False)
        self.norm_out = ConditionalBatchNorm(after, embedding)
        self.conv_out = nn.Conv2d(after, after, 3, padding=1, bias=False)
        self.shortcut = nn.Conv2d(before, after, 1)

    def forward(self, maps: Tensor, embedded: Tensor | None) -> Tensor:
        """Return (B, after, 2H, 2W) maps."""
        short = interpolate(self.shortcut(maps), scale_factor=2.0, mode="nearest")
        maps = self.conv_in(relu(self.norm_in(maps, embedded)))
        return short + self.conv_out(relu(self.norm_out(maps, embedded)))


class Pyramid(nn.Module):
    """Dense, reshape, four doublings, and a last deconvolution to one channel.

    The condition always stands beside the latent at the input. With injection `norm` an embedding
    of it also sets scale and shift of every normalisation.
    """

    def __init__(
        self,
        width: int,
        latent: int,
        condition: int,
        *,
        injection: str = "concat",
        embedding: int = 64,
        residual: bool = False,
        attention: bool = False,
    ):
        super().__init__()
        self.noise = latent
        """Normal numbers a sample."""
        embedding = embedding if injection == "norm" else 0
        channels, features = widths(width)[::-1], bottom_features(width)
        self.embedding = ConditionEmbedding(condition, embedding) if embedding else None
        self.dense = nn.Linear(latent + condition, features, bias=False)
        self.norm = ConditionalBatchNorm(features, flat=True)
        block = ResidualUp if residual else PlainUp
        self.blocks = nn.ModuleList([block(*pair, embedding) for pair in pairwise(channels)])
        sides = [BOTTOM << level for level in range(1, len(channels))]
        self.attention = attending(sides, channels[1:]) if attention else nn.ModuleDict()
        # A residual block ends in a sum, which still has to be normed; a plain one has been.
        self.last = ConditionalBatchNorm(channels[-1], embedding) if residual else None
        self.image = nn.ConvTranspose2d(channels[-1], 1, 4, stride=2, padding=1)
        nn.init.normal_(self.dense.weight, 0.0, 0.02)
        for part in (self.norm, self.blocks, self.attention, self.last, self.image):
            if part is not None:
                part.apply(_initialise_layers)

    def forward(self, latent: Tensor, condition: Tensor) -> Tensor:
        """Return (B, 1, 128, 128) in [-1, 1] of (B, latent) noise and (B, condition)."""
        embedded = None if self.embedding is None else self.embedding(condition)
        maps = self.dense(torch.cat([latent, condition], -1))
        maps = relu(self.norm(maps, None)).unflatten(1, (-1, BOTTOM, BOTTOM))
        maps = maps.contiguous(memory_format=torch.channels_last)
        maps = through(self.blocks, self.attention, maps, embedded)
        if self.last is not None:
            maps = relu(self.last(maps, embedded))
        return torch.tanh(self.image(maps))


def _initialise_layers(module: nn.Module) -> None:
    """DCGAN's weights for convolutions and plain norms; dense layers keep their own."""
    if not isinstance(module, nn.Linear):
        initialise(module)
