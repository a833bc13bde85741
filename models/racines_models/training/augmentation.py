"""What a grader's training images are varied by: the scanner's settings, never the anatomy.

A mirrored heart is another view, so nothing is flipped, turned or moved; and a shadow is poor
coupling, which lowers the true grade, so none is drawn. What is left keeps label and grade.
"""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from racines_data.randomness import normal, uniform

SCANNER, NOISE, CHOICES = 0, 1, 2
"""Random streams of one image."""


@dataclass(frozen=True)
class Augmentation:
    """How strongly training images vary; 0 switches a part off."""

    gain: float = 0.1
    """Standard deviation of the log of a gain, one an image."""
    tgc: float = 0.05
    """Standard deviation of the log of a gain that grows linearly with depth, at the far end;
    the near end gets its inverse (time-gain compensation)."""
    gamma: float = 0.05
    """Standard deviation of the log of an exponent on the gray levels."""
    blur: float = 0.2
    """Share of the images that are blended with their 3 x 3 mean, by a uniform weight."""
    erase: float = 0.1
    """Share of the images with a black box (random erasing, Zhong et al., 2020)."""
    erase_side: float = 0.2
    """Largest side of the box as a share of the image's."""
    noise: float = 0.02
    """Standard deviation of pixel noise, 1 = white."""


def augment(x: Tensor, seeds: Tensor, config: Augmentation) -> Tensor:
    """Vary (B, 1, S, S) images in [-1, 1] by (B,) seeds, each by its own; black stays black."""
    light = (x + 1.0) / 2.0
    tissue = light > 0
    scanner = normal(seeds, 3, SCANNER).unbind(-1)
    choices = uniform(seeds, 6, CHOICES)
    if config.blur:
        weight = torch.where(choices[:, 0] < config.blur, choices[:, 1], 0.0).view(-1, 1, 1, 1)
        mean = functional.avg_pool2d(light, 3, stride=1, padding=1, count_include_pad=False)
        light = light.lerp(mean, weight)
    if config.gamma:
        light = light.clamp_min(1e-6).pow((config.gamma * scanner[2]).exp().view(-1, 1, 1, 1))
    depth = torch.linspace(-1.0, 1.0, x.shape[-2], device=x.device)
    slope = config.tgc * scanner[1].unsqueeze(-1) * depth
    gain = (config.gain * scanner[0].unsqueeze(-1) + slope).exp()
    light = light * gain.view(len(x), 1, -1, 1)
    if config.noise:
        light = light + config.noise * normal(seeds, x[0].numel(), NOISE).view(x.shape)
    if config.erase:  # a box of half to the whole largest side
        size = x.shape[-1]
        half = size * config.erase_side * (0.25 + 0.25 * choices[:, 3])
        half = torch.where(choices[:, 2] < config.erase, half, -1.0).unsqueeze(-1)
        place = torch.arange(size, device=x.device) + 0.5
        down = (place - size * choices[:, 4:5]).abs() < half
        right = (place - size * choices[:, 5:6]).abs() < half
        tissue = tissue & ~(down.unsqueeze(-1) & right.unsqueeze(-2)).unsqueeze(1)
    light = light.clamp(0.0, 1.0) * tissue
    return (light * 2.0 - 1.0).contiguous(memory_format=torch.channels_last)
