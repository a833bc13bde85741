"""StyleGAN2's generator for gray images: mapping network, modulated convolutions, noise.

Source: Karras et al., Analyzing and Improving the Image Quality of StyleGAN, 2020; mapping network
and noise inputs from Karras et al., A Style-Based Generator Architecture for GANs, 2019.
"""

import math
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn.functional import conv2d, interpolate, leaky_relu, linear, pixel_shuffle

from racines_models.networks.layers import BOTTOM, widths

SLOPE, GAIN = 0.2, math.sqrt(2.0)


class EqualDense(nn.Module):
    """A dense layer with unit-variance weights that are scaled when used, so all learn alike."""

    def __init__(self, inputs: int, outputs: int, bias: float = 0.0, rate: float = 1.0):
        super().__init__()
        self.weight = nn.Parameter(torch.randn(outputs, inputs) / rate)
        self.bias = nn.Parameter(torch.full((outputs,), bias / rate))
        self.scale, self.rate = rate / math.sqrt(inputs), rate

    def forward(self, x: Tensor) -> Tensor:
        """Return (B, outputs) of (B, inputs)."""
        return linear(x, self.weight * self.scale, self.bias * self.rate)


class Mapping(nn.Module):
    """Latent and condition to the style w: two vectors of one width and size, then dense layers.

    The condition is embedded first, or a hundred numbers of noise would drown its fifteen (as in
    Karras et al., Training GANs with Limited Data, 2020). The layers learn at `rate` of the others.
    """

    def __init__(self, latent: int, condition: int, style: int, layers: int, rate: float):
        super().__init__()
        self.embedding = EqualDense(condition, latent)
        sizes = pairwise([2 * latent, *[style] * layers])
        self.layers = nn.ModuleList([EqualDense(*pair, rate=rate) for pair in sizes])

    def forward(self, latent: Tensor, condition: Tensor) -> Tensor:
        """Return (B, style) of (B, latent) and (B, condition)."""
        latent = latent * (latent.square().mean(1, keepdim=True) + 1e-8).rsqrt()
        embedded = self.embedding(condition)
        style = torch.cat([latent.to(embedded.dtype), embedded], 1)
        for layer in self.layers:
            style = GAIN * leaky_relu(layer(style), SLOPE)
        return style


class ModulatedConv(nn.Module):
    """A convolution whose input channels the style scales, and whose output it leaves at unit size.

    Scaling the maps before and after one shared convolution equals scaling the weights of each
    sample (section 2.2), without a convolution a sample.
    """

    def __init__(self, before: int, after: int, style: int, size: int = 3, demodulate: bool = True):
        super().__init__()
        self.weight = nn.Parameter(torch.randn(after, before, size, size))
        self.scale = 1.0 / math.sqrt(before * size * size)
        self.style = EqualDense(style, before, bias=1.0)
        self.demodulate = demodulate

    def forward(self, maps: Tensor, style: Tensor) -> Tensor:
        """Return (B, after, H, W) maps."""
        weight, scales = self.weight * self.scale, self.style(style).float()
        out = conv2d(maps * _spread(scales, maps), weight, padding=self.weight.shape[-1] // 2)
        if not self.demodulate:
            return out
        power = weight.float().square().sum((2, 3))
        sizes = (scales.square()[:, None] * power).sum(2)
        return out * _spread((sizes + 1e-8).rsqrt(), out)


class StyledLayer(nn.Module):
    """Modulated convolution, noise of a learned strength, bias, leaky ReLU."""

    def __init__(self, before: int, after: int, style: int, up: bool):
        super().__init__()
        self.conv = ModulatedConv(before, after, style)
        self.strength = nn.Parameter(torch.zeros(()))
        self.bias = nn.Parameter(torch.zeros(after))
        self.up = up

    def forward(self, maps: Tensor, style: Tensor, noise: Tensor) -> Tensor:
        """Return (B, after, H, W) maps, of twice the side if the layer goes up; noise (B, HW)."""
        if self.up:
            maps = _doubled(maps)
        maps = self.conv(maps, style)
        noise = noise.unflatten(1, (1, *maps.shape[2:]))
        maps = maps + (self.strength * noise + self.bias[:, None, None]).to(maps.dtype)
        return GAIN * leaky_relu(maps, SLOPE)


class StyleSynthesis(nn.Module):
    """Mapping, a learned 4×4 map, two styled layers a doubling, and gray skips that add up.

    Features end at 64×64; the last gray map has four channels there, which interleave to 128×128:
    a CPU would spend most of its time at the finest level.
    """

    def __init__(
        self, width: int, latent: int, condition: int, style: int, *, layers: int, rate: float
    ):
        super().__init__()
        channels = widths(width)[::-1]
        pairs = list(pairwise(channels))
        sides = [BOTTOM] + [BOTTOM << (level + 1) for level in range(len(pairs)) for _ in range(2)]
        self.sizes = [latent, *(side * side for side in sides)]
        self.noise = sum(self.sizes)
        """Normal numbers a sample: the latent, and one for each place of each styled layer."""
        self.mapping = Mapping(latent, condition, style, layers, rate)
        self.start = nn.Parameter(torch.randn(1, channels[0], BOTTOM, BOTTOM))
        self.layers = nn.ModuleList([StyledLayer(channels[0], channels[0], style, up=False)])
        for before, after in pairs:
            self.layers.append(StyledLayer(before, after, style, up=True))
            self.layers.append(StyledLayer(after, after, style, up=False))
        shades = [1] * (len(pairs) - 1) + [4]
        ends = zip(channels[1:], shades, strict=True)
        gray = [ModulatedConv(*end, style, 1, demodulate=False) for end in ends]
        # Four alike interleave to no checkerboard (Aitken et al., Checkerboard artifact free
        # sub-pixel convolution, 2017).
        last = gray[-1].weight.data
        last.copy_(last[:1].expand_as(last))
        self.gray = nn.ModuleList(gray)
        self.bias = nn.Parameter(torch.zeros(()))

    def forward(self, noise: Tensor, condition: Tensor) -> Tensor:
        """Return (B, 1, 128, 128) in [-1, 1] of (B, noise) numbers and (B, condition)."""
        latent, *inputs = noise.split(self.sizes, 1)
        style = self.mapping(latent, condition)
        maps = self.start.expand(len(latent), -1, -1, -1)
        maps = maps.contiguous(memory_format=torch.channels_last)
        gray: Tensor | None = None
        for place, layer in enumerate(self.layers):
            maps = layer(maps, style, inputs[place])
            if place and place % 2 == 0:
                shades = self.gray[place // 2 - 1](maps, style)
                gray = shades if gray is None else shades + _doubled(gray)
        assert gray is not None
        return torch.tanh(pixel_shuffle(gray, 2) + self.bias)


def _doubled(maps: Tensor) -> Tensor:
    return interpolate(maps, scale_factor=2.0, mode="bilinear", align_corners=False)


def _spread(scales: Tensor, maps: Tensor) -> Tensor:
    return scales[:, :, None, None].to(maps.dtype)
