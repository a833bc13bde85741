"""The two pyramids of a GAN: from latent and condition to an image, and from that to a verdict.

The generator is that of every GAN of the paper but StyleGAN; the adversary that of every GAN here.
"""

import math
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d, interpolate, leaky_relu, relu
from torch.nn.utils.parametrizations import spectral_norm

from racines_data.imaging import IMAGE_SIZE
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

JOININGS = ("last", "layers", "projection")
NORMALISATIONS = ("none", "batch", "spectral")
SLOPE = 0.2


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
            for module in [] if part is None else part.modules():
                if not isinstance(module, nn.Linear):  # dense layers keep PyTorch's weights
                    initialise(module)

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


class PlainDown(nn.Module):
    """Halves the side: strided convolution, norm, leaky ReLU (DCGAN)."""

    def __init__(self, before: int, after: int, embedding: int, normalisation: str):
        super().__init__()
        batch = normalisation == "batch"
        self.conv = nn.Conv2d(before, after, 4, stride=2, padding=1, bias=not batch)
        self.norm = nn.BatchNorm2d(after) if batch else nn.Identity()
        self.bias = nn.Linear(embedding, after, bias=False) if embedding else None

    def forward(self, maps: Tensor, embedded: Tensor) -> Tensor:
        """Return (B, after, H/2, W/2) maps."""
        maps = self.norm(self.conv(maps))
        if self.bias is not None:
            maps = maps + self.bias(embedded)[:, :, None, None].to(maps.dtype)
        return leaky_relu(maps, SLOPE)


class ResidualDown(nn.Module):
    """Halves the side: two convolutions beside a pooled 1×1 shortcut.

    Source: Miyato et al., Spectral Normalization for GANs, 2018, appendix B, whose branches are
    summed. Without spectral weights, which shrink a map by themselves, the sum of two branches of
    unit variance is divided by √2, as in StyleGAN2.
    """

    def __init__(self, before: int, after: int, embedding: int, normalisation: str):
        super().__init__()
        batch = normalisation == "batch"
        self.scale = 1.0 if normalisation == "spectral" else math.sqrt(0.5)
        self.conv = nn.Conv2d(before, before, 3, padding=1, bias=not batch)
        self.norm = nn.BatchNorm2d(before) if batch else nn.Identity()
        self.down = PlainDown(before, after, embedding, normalisation)
        self.shortcut = nn.Conv2d(before, after, 1)

    def forward(self, maps: Tensor, embedded: Tensor) -> Tensor:
        """Return (B, after, H/2, W/2) maps."""
        short = self.shortcut(avg_pool2d(maps, 2))
        maps = leaky_relu(self.norm(self.conv(maps)), SLOPE)
        return (short + self.down(maps, embedded)) * self.scale


class Discriminator(nn.Module):
    """Convolutions from 128 to 4, flattened, and a verdict on image and condition together.

    `joining` says where the condition enters: `last`, beside the features at the last layer (the
    paper's VAE-GAN; the two then only add, so no single image can contradict its condition);
    `layers`, as a bias of every layer, and at the last; `projection`, as an inner product with the
    features (Miyato and Koyama, cGANs with Projection Discriminator, 2018).
    """

    def __init__(
        self,
        width: int,
        condition: int,
        embedding: int,
        *,
        joining: str = "last",
        normalisation: str = "batch",
        residual: bool = False,
        attention: bool = False,
    ):
        super().__init__()
        self.joining = joining
        channels = widths(width)
        injected = embedding if joining == "layers" else 0
        self.embedding = ConditionEmbedding(condition, embedding, normalisation == "batch")
        self.first = PlainDown(1, channels[0], injected, normalisation)
        block = ResidualDown if residual else PlainDown
        pairs = pairwise(channels)
        self.blocks = nn.ModuleList([block(*pair, injected, normalisation) for pair in pairs])
        sides = [IMAGE_SIZE >> level for level in range(2, len(channels) + 1)]
        self.attention = attending(sides, channels[1:]) if attention else nn.ModuleDict()
        features = bottom_features(width)
        if joining == "projection":
            self.matched = nn.Linear(features, embedding)
            self.verdict = nn.Linear(features, 1)
        else:
            self.verdict = nn.Linear(features + embedding, 1)
        if normalisation == "batch":
            for part in (self.first, self.blocks, self.attention, self.verdict):
                part.apply(initialise)
        elif normalisation == "spectral":
            for module in [*self.modules()]:
                if isinstance(module, nn.Conv2d | nn.Linear):
                    spectral_norm(module)
        else:
            self.apply(_keep_variance)
        self.register_buffer("judged", torch.zeros((), dtype=torch.int64))

    judged: Tensor
    """Steps of the adversary so far; a buffer, so that a resumed run goes on counting."""

    def judge(self, images: Tensor, condition: Tensor) -> Tensor:
        """Return (B,) logits, large for a real (B, 1, 128, 128) image at its own condition."""
        embedded = self.embedding(condition)
        maps = self.first(images.contiguous(memory_format=torch.channels_last), embedded)
        features = through(self.blocks, self.attention, maps, embedded).flatten(1)
        if self.joining != "projection":
            return self.verdict(torch.cat([features, embedded.to(features.dtype)], -1)).squeeze(-1)
        matched = self.matched(features) * embedded
        return self.verdict(features).squeeze(-1) + matched.sum(-1) / math.sqrt(matched.shape[-1])

    forward = judge
    """The same; a trainer may wrap this one in mixed precision."""


def _keep_variance(module: nn.Module) -> None:
    """He et al., 2015: where no norm rescales them, maps keep their variance from layer to layer.

    PyTorch's own initial weights shrink them; the logits of a residual discriminator then hardly
    differ, and the generator outruns it.
    """
    if isinstance(module, nn.Conv2d | nn.Linear):
        nn.init.kaiming_normal_(module.weight, SLOPE)
        if module.bias is not None:
            nn.init.zeros_(module.bias)
