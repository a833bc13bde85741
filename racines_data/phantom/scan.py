"""From beams to picture: log compression and scan conversion to the square image."""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from racines_data.imaging import IMAGE_SIZE
from racines_data.phantom.config import ProbeConfig


class ScanConverter(NamedTuple):
    """Speckle reduction, then bilinear weights from the polar grid to the sector's pixels."""

    smooth_beams: Tensor  # (L, L) from the left
    smooth_samples: Tensor  # (S, S) from the right
    pixels: Tensor  # (P,) int64 flat indices of the pixels inside the sector
    taps: Tensor  # (4 * P,) int64 flat indices into the (beams, samples) grid
    weights: Tensor  # (4, P) float32

    def convert(self, polar: Tensor) -> Tensor:
        """Turn (B, beams, samples) gray levels 0-255 into (B, 128, 128) uint8 images."""
        count = len(polar)
        polar = torch.bmm(polar, self.smooth_samples.expand(count, -1, -1))
        polar = torch.bmm(self.smooth_beams.expand(count, -1, -1), polar)
        picked = polar.flatten(1).index_select(1, self.taps)
        gray = (picked.view(count, 4, -1) * self.weights).sum(1)
        image = torch.zeros((len(polar), IMAGE_SIZE**2), dtype=torch.uint8, device=polar.device)
        image[:, self.pixels] = (gray + 0.5).to(torch.uint8)
        return image.view(-1, IMAGE_SIZE, IMAGE_SIZE)


def scan_converter(probe: ProbeConfig, device: torch.device) -> ScanConverter:
    """Lay the sector into the image: apex at the top centre, as wide as the image."""
    lateral, axial = pixel_grid(probe)
    radius = (lateral.square() + axial.square()).sqrt()
    angle = torch.atan2(lateral, axial)
    beam = (angle / probe.half_angle + 1.0) / 2.0 * (probe.beams - 1)
    sample = radius / probe.depth * probe.samples - 0.5
    inside = (angle.abs() <= probe.half_angle) & (radius <= probe.depth)
    beam = beam[inside].clamp(0, probe.beams - 1)
    sample = sample[inside].clamp(0, probe.samples - 1)
    b0 = beam.floor().clamp_max(probe.beams - 2).long()
    s0 = sample.floor().clamp_max(probe.samples - 2).long()
    fb, fs = (beam - b0).float(), (sample - s0).float()
    flat = b0 * probe.samples + s0
    taps = torch.stack([flat, flat + 1, flat + probe.samples, flat + probe.samples + 1])
    weights = torch.stack([(1 - fb) * (1 - fs), (1 - fb) * fs, fb * (1 - fs), fb * fs])
    along, across = probe.smoothing
    converter = ScanConverter(
        smooth_beams=averaging(probe.beams, across, 3),
        smooth_samples=averaging(probe.samples, along, 3).T.contiguous(),
        pixels=inside.flatten().nonzero().squeeze(1),
        taps=taps.flatten(),
        weights=weights,
    )
    return ScanConverter(*(part.to(device) for part in converter))


def averaging(size: int, sigma: float, reach: float | None = None) -> Tensor:
    """Return the matrix of a Gaussian average over neighbours; rows sum to one."""
    matrix = gaussian_matrix(size, sigma, reach) if sigma > 0 else torch.eye(size)
    return matrix / matrix.sum(1, keepdim=True)


def gaussian_matrix(size: int, sigma: float, reach: float | None = None) -> Tensor:
    """Return the (size, size) Gaussian of the rows' distances, 0 beyond `reach` sigmas."""
    offset = torch.arange(size).unsqueeze(0) - torch.arange(size).unsqueeze(1)
    matrix = torch.exp(-0.5 * (offset / sigma) ** 2)
    if reach is not None:
        matrix[offset.abs() > math.ceil(reach * sigma)] = 0.0
    return matrix


def pixel_grid(probe: ProbeConfig) -> tuple[Tensor, Tensor]:
    """Return the lateral and axial coordinates, m, of the (128, 128) pixel centres (float64)."""
    pixel = 2.0 * probe.depth * math.sin(probe.half_angle) / IMAGE_SIZE
    place = torch.arange(IMAGE_SIZE, dtype=torch.float64)
    rows, columns = torch.meshgrid(place, place, indexing="ij")
    return (columns - (IMAGE_SIZE - 1) / 2) * pixel, (rows + 0.5) * pixel


def sector_mask(probe: ProbeConfig) -> Tensor:
    """Return the (128, 128) bool mask of the sector."""
    lateral, axial = pixel_grid(probe)
    radius = (lateral.square() + axial.square()).sqrt()
    return (torch.atan2(lateral, axial).abs() <= probe.half_angle) & (radius <= probe.depth)


def log_compress(power: Tensor, probe: ProbeConfig) -> Tensor:
    """Map echo power (1 is myocardium's) to gray levels 0-255: log compression, then gray map."""
    shade = torch.log10(power.clamp_min(1e-12)).mul_(10.0 / probe.dynamic_range)
    shade = shade.add_(1.0 + probe.gain / probe.dynamic_range).clamp_(0.0, 1.0)
    return shade.pow_(probe.gray_map).mul_(255.0) if probe.gray_map != 1.0 else shade.mul_(255.0)
