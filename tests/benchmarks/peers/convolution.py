"""The convolution simulator of SonoGym (Ao et al., 2025, arXiv:2507.01152), after Salehi et al.

Salehi et al. (2015), "Patient-specific 3D ultrasound simulation based on convolutional ray-tracing
and appearance optimization". Of each pixel of a label slice, whose columns are taken for the
paths of sound: E = I (Z₁ - Z₂)² / (Z₁ + Z₂)² cos α at interfaces, blurred by an oscillating kernel,
and B = I (H ∗ T), where T is a scatterer with a probability. I falls exponentially with depth, and
the scatterers of a patch share a slower variation. Random maps are fixed in space and sliced, too.
"""

import math

import torch
from torch import Tensor
from torch.nn import functional

from racines_data.geometry import Pose
from tests.benchmarks.peers.slices import AIR, LabelVolume

KERNEL = 11
"""Width of the two kernels, pixels, as published."""
FREQUENCY, ELEMENT = 2.5, 0.121
"""MHz; and the depth of a pixel, cm."""
PATCH, SLOW = 30, 10
"""Pixels that share the slow variation, and its grid."""
ECHO = 20.0
"""Share of the interfaces' echoes."""


class Convolution:
    """Draws (B, 128, 128) images of label slices."""

    def __init__(self, volume: LabelVolume) -> None:
        """Give each tissue its attenuation, impedance and scatterers; draw the random maps."""
        self.volume = volume
        rows = [[0.2, 0.0004, 0.0, 0.0, 0.0, 0.08]]  # air
        for tissue in volume.anatomy.tissues:
            shine = min(1.0, 10.0 ** (tissue.echogenicity / 20.0))
            rows.append([tissue.attenuation / 8.686, tissue.impedance, shine, 0.6, 0.1, 0.08])
        self.table = torch.tensor(rows)
        self.interface = kernel(3.0, 3.0, 0.25)
        self.speckle = kernel(1.0, 2.0, 0.25)
        generator = torch.Generator().manual_seed(0)
        self.random = torch.randn((len(volume.flat), 2), generator=generator)
        self.slow = torch.randn((SLOW**3,), generator=generator)
        self.patch = self._patches()

    def _patches(self) -> Tensor:
        rows, columns = torch.meshgrid(torch.arange(128), torch.arange(128), indexing="ij")
        return (rows // PATCH) * SLOW + columns // PATCH

    def render(self, pose: Pose) -> Tensor:
        """Return (B, 128, 128) uint8 images of poses."""
        volume = self.volume
        index = volume.index(pose, volume.pixels)
        labels, random = volume.flat[index], self.random[index]
        attenuation, impedance, mean, density, spread, slow = self.table[labels].unbind(-1)
        reach = torch.exp(attenuation.cumsum(1).mul_(-2.0 * ELEMENT * FREQUENCY / 10.0))
        above = torch.cat([impedance[:, :1], impedance[:, :-1]], 1)
        edge = (labels != torch.cat([labels[:, :1], labels[:, :-1]], 1)).float()
        echo = ((impedance - above) / (impedance + above + 1e-5)).square_() * edge
        echo = (reach * echo * facing(edge)).clamp_max_(0.1)
        echo = functional.conv2d(echo.unsqueeze(1), self.interface, padding="same")[:, 0]
        scatter = random[..., 0] * spread + mean
        scatter = torch.where(random[..., 1] <= density, scatter, 0.0)
        far = (pose.position[:, 2] * 1e3).long().remainder(SLOW) * SLOW * SLOW
        scatter *= 1.0 + slow * self.slow[self.patch + far[:, None, None]]
        back = functional.conv2d(scatter.unsqueeze(1), self.speckle, padding="same")[:, 0]
        gray = (ECHO * echo + reach * back).clamp_(0.0, 1.0).mul_(255.0)
        gray[labels == AIR] = 0.0
        return gray.to(torch.uint8)


def kernel(along: float, across: float, frequency: float) -> Tensor:
    """Return the (1, 1, K, K) kernel: a Gaussian that oscillates along the path of sound."""
    place = torch.arange(KERNEL) - (KERNEL - 1) / 2
    wave = torch.exp(-0.5 * (place / along) ** 2) * torch.cos(2 * math.pi * frequency * place)
    return (wave.unsqueeze(1) * torch.exp(-0.5 * (place / across) ** 2))[None, None]


def facing(edge: Tensor) -> Tensor:
    """Return the cosine between the path of sound and the normal of interfaces (B, H, W)."""
    padded = functional.pad(edge, (1, 1, 1, 1), "reflect")
    along = edge - padded[:, :-2, 1:-1]
    across = 0.5 * (padded[:, 1:-1, 2:] - padded[:, 1:-1, :-2])
    return along / (torch.sqrt(along.square() + across.square()) + 1e-5)
