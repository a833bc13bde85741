"""The ray-casting renderer of LOTUS (Velikova et al., MICCAI 2023), batched over slices.

Equations 1 to 6 of the paper: along each ray attenuation and what interfaces let through are
products of what lies before; an interface is where the impedance steps; scatterers are drawn with
a smooth threshold, so that the picture is differentiable; both are blurred by one small kernel,
added, and warped from rays to a sector.
"""

import torch
from torch import Tensor
from torch.nn import functional

from racines_data.geometry import Pose
from racines_data.phantom.acoustics import pixel_grid
from tests.benchmarks.peers.slices import LabelVolume

SHARPNESS, STEEPNESS, TGC = 0.1, 10.0, 8.0
"""Of interfaces, of the scatterers' threshold, and the gain at the deepest sample, as published."""
PATH = 4.0
"""Length of a ray in the units of attenuation, as published."""


class Rays:
    """Draws (B, 128, 128) images of labels along rays."""

    def __init__(self, volume: LabelVolume) -> None:
        """Give each tissue its acoustic values, and lay the sector."""
        self.volume = volume
        rows = [[0.0, 0.0004, 0.0, 0.0, 0.0]]  # air
        for tissue in volume.anatomy.tissues:
            shine = min(1.0, 10.0 ** (tissue.echogenicity / 20.0))
            rows.append([tissue.attenuation, tissue.impedance, shine, 0.6, 0.1])
        self.table = torch.tensor(rows)
        place = torch.arange(-3, 4, dtype=torch.float32)
        along, across = (torch.exp(-0.5 * (place / sigma) ** 2) for sigma in (0.5, 1.5))
        blur = torch.outer(across, along)
        self.kernel = (blur / blur.sum())[None, None]
        self.grid = self._sector()

    def _sector(self) -> Tensor:
        """Return the (1, 128, 128, 2) places of pixels in the (beams, samples) grid."""
        probe = self.volume.config.probe
        lateral, axial = pixel_grid(probe)
        radius, angle = torch.hypot(lateral, axial), torch.atan2(lateral, axial)
        place = torch.stack([2.0 * radius / probe.depth - 1.0, angle / probe.half_angle], -1)
        return place.float().unsqueeze(0)

    def render(self, pose: Pose, generator: torch.Generator) -> Tensor:
        """Return (B, 128, 128) uint8 images of poses."""
        volume = self.volume
        values = self.table[volume.flat[volume.index(pose, volume.rays)]]
        attenuation, impedance, mean, density, spread = values.unbind(-1)
        step = torch.diff(impedance, dim=-1, prepend=impedance[..., :1])
        border = 1.0 - torch.exp(-step.square() / SHARPNESS)
        total = impedance + torch.cat([impedance[..., 1:], impedance[..., -1:]], -1)
        reflected = torch.sigmoid((step / total.clamp_min(1e-6)).square())
        depth = attenuation.shape[-1]
        left = torch.exp(attenuation * (-PATH / (depth - 1))).cumprod(-1)
        left *= torch.linspace(1.0, TGC, depth)
        passed = (1.0 - reflected * border).cumprod(-1)
        texture = torch.randn(attenuation.shape, generator=generator)
        threshold = torch.randn(attenuation.shape, generator=generator)
        scatter = torch.sigmoid(STEEPNESS * (density - threshold)) * (texture * spread + mean)
        back, edges = (
            functional.conv2d(each.unsqueeze(1), self.kernel, padding="same")[:, 0]
            for each in (scatter, border)
        )
        polar = (left * back + left * passed * reflected * edges).clamp_(0.0, 1.0)
        grid = self.grid.expand(len(polar), -1, -1, -1)
        image = functional.grid_sample(polar.unsqueeze(1), grid, align_corners=True)[:, 0]
        return image.mul_(255.0).to(torch.uint8)
