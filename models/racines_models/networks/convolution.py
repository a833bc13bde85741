"""Sizes of the pyramids between a 128×128 image and a 4×4 map, and what surrounds them."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn

from racines_data.imaging import IMAGE_SIZE

LEVELS = 5
"""Halvings from 128 to 4."""
BOTTOM = IMAGE_SIZE >> LEVELS


def widths(width: int) -> list[int]:
    """Return the channels after each halving: doubling thrice, then level."""
    return [width * min(1 << level, 8) for level in range(LEVELS)]


def bottom_features(width: int) -> int:
    """Return the entries of the flattened 4×4 map."""
    return widths(width)[-1] * BOTTOM * BOTTOM


def downward(width: int) -> nn.Sequential:
    """Return (B, 1, 128, 128) -> (B, features): strided convolutions, then flatten."""
    layers: list[nn.Module] = []
    previous = 1
    for channels in widths(width):
        layers += [
            nn.Conv2d(previous, channels, 4, stride=2, padding=1, bias=False),
            nn.BatchNorm2d(channels),
            nn.LeakyReLU(0.2, inplace=True),
        ]
        previous = channels
    return nn.Sequential(*layers, nn.Flatten())


def initialise(module: nn.Module) -> None:
    """Draw weights as DCGAN does: N(0, 0.02), batch-norm scales N(1, 0.02).

    Source: Radford et al., Unsupervised Representation Learning with Deep Convolutional
    Generative Adversarial Networks, 2016, section 4.
    """
    if isinstance(module, nn.Conv2d | nn.ConvTranspose2d | nn.Linear):
        nn.init.normal_(module.weight, 0.0, 0.02)
        if module.bias is not None:
            nn.init.zeros_(module.bias)
    elif isinstance(module, nn.BatchNorm1d | nn.BatchNorm2d):
        nn.init.normal_(module.weight, 1.0, 0.02)
        nn.init.zeros_(module.bias)


def to_range(images: Tensor) -> Tensor:
    """Turn (B, 128, 128) uint8 into (B, 1, 128, 128) float32 in [-1, 1]."""
    return images.unsqueeze(1).to(torch.float32) / 127.5 - 1.0


def to_gray(images: Tensor) -> Tensor:
    """Turn (B, 1, 128, 128) in [-1, 1] into (B, 128, 128) uint8."""
    return ((images.float() + 1.0) * 127.5).round().clamp(0, 255).to(torch.uint8).squeeze(1)


@contextmanager
def frozen(net: nn.Module) -> Iterator[None]:
    """Let gradients pass through a network without computing those of its weights."""
    net.requires_grad_(False)
    try:
        yield
    finally:
        net.requires_grad_(True)
