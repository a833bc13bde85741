"""Pictures of a batch whose rows may be of different patients: the phantom's acoustics, row by row.

As `phantom.acoustics`, whose point spread function and noise it shares, but settings are tensors,
blood is drawn anew in every frame, and the scan conversion differs with the sector's width.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from racines_data.imaging import IMAGE_SIZE
from racines_data.patients.labels import ATTENUATIONS, BLOOD, CODES, shown
from racines_data.patients.sampling import BITS, SPACING, Grid, Samples
from racines_data.patients.settings import PROBE, SOFT_LOSS, Settings
from racines_data.phantom.acoustics import (
    NOISE_BANK,
    SPECKLE_GAIN,
    SPECULAR_LOSS,
    Beams,
    averaging,
    echo_power,
    make_beams,
)
from racines_data.phantom.volume import ALONG_SHEET, SCATTERER_STEP, SHEET
from racines_data.randomness import derive

FAINTEST = 1e-8
"""Least power of a look, below any black: an echo that cancels itself hangs on rounding alone."""
AIR_LOSS = 6.0  # one-way loss of a sample above the skin, dB
SPECULAR_GAIN = 0.022  # less than the phantom's: tissue has no polished faces as gel has
APEX_BEAMS = 3.0  # reach of the mean over beams where many of them fill a pixel, beams
BLOOD_GAIN = 0.9  # blood's speckle has no memory from voxel to voxel: the blur gives it less


class Scanner(NamedTuple):
    """What all rows share: point spread, noise, speckle reduction.

    Narrow filters are a few shifted sums, which cost a fraction of a matrix; the veil of multiple
    scattering is so wide that it is found at the nodes of the coarse grid.
    """

    beams: Beams
    sideways: Tensor  # (L, 1) dB: elements hear less from aside
    pulse: tuple[float, ...]  # taps on one side, the middle first, unit energy
    veil: tuple[Tensor, Tensor]  # (13, L) and (S, 19), to the nodes
    nodes: tuple[Tensor, Tensor]  # (L, 13) and (19, S), from them
    smoothing: tuple[tuple[float, ...], tuple[float, ...]]  # taps over samples, and over beams
    level: Tensor  # (L, S) undoes what the smoothing loses at the grid's edges
    apex: tuple[Tensor, Tensor]  # (L, L) mean over neighbours, and (N,) its share in the first N


def make_scanner(grid: Grid, device: torch.device) -> Scanner:
    """Precompute what all rows share."""
    beams = make_beams(PROBE, SOFT_LOSS, device)
    aside = torch.linspace(-1.0, 1.0, PROBE.beams).square().unsqueeze(1)
    pulse = _taps(PROBE.axial_sigma * PROBE.samples / PROBE.depth, 4.0)
    energy = (2.0 * sum(tap * tap for tap in pulse) - 1.0) ** 0.5
    kernels = tuple(_taps(sigma, 3.0) for sigma in PROBE.smoothing)
    kernels = tuple(tuple(tap / (2.0 * sum(k) - 1.0) for tap in k) for k in kernels)
    flat = torch.ones(1, 1, PROBE.beams, PROBE.samples)
    last = [size - 1 for size in (PROBE.beams, PROBE.samples)]
    node_beam, node_sample = (
        (torch.arange(weights.shape[axis]) * SPACING).clamp_max(end).to(device)
        for weights, axis, end in ((grid.across, 1, last[0]), (grid.along, 0, last[1]))
    )
    across = beams.veil_across / 10.0 ** (PROBE.haze / 10.0)
    return Scanner(
        beams=beams,
        sideways=(-PROBE.directivity * aside).to(device),
        pulse=tuple(tap / energy for tap in pulse),
        veil=(across[node_beam].contiguous(), beams.veil_along[:, node_sample].contiguous()),
        nodes=(grid.across / SPACING, grid.along / SPACING),
        smoothing=(kernels[0], kernels[1]),
        apex=(averaging(PROBE.beams, APEX_BEAMS, 3).to(device), _apex_share().to(device)),
        level=(1.0 / shifted(shifted(flat, kernels[0], 3), kernels[1], 2))[0, 0].to(device),
    )


def _apex_share() -> Tensor:
    """Return (N,) how far the first samples are averaged over beams, many of which fill a pixel."""
    pixels = (
        IMAGE_SIZE / PROBE.samples
    )  # a sample; the sector is about as deep as the image is high
    arc = 2.0 * PROBE.half_angle * pixels * (torch.arange(PROBE.samples) + 0.5)
    share = (PROBE.beams / arc - 1.0) / APEX_BEAMS
    return share[share > 0.05].clamp_max(1.0)


def _taps(sigma: float, reach: float) -> tuple[float, ...]:
    """Return a Gaussian's taps from its middle outwards, the first of them 1."""
    return tuple(math.exp(-0.5 * (i / sigma) ** 2) for i in range(math.ceil(reach * sigma) + 1))


def shifted(field: Tensor, taps: tuple[float, ...], axis: int) -> Tensor:
    """Filter a field along an axis with a symmetric kernel; beyond the edges lies nothing."""
    size, total = field.shape[axis], field * taps[0]
    for shift, tap in enumerate(taps[1:], 1):
        count = size - shift
        for to, start in ((0, shift), (shift, 0)):
            total.narrow(axis, to, count).add_(field.narrow(axis, start, count), alpha=tap)
    return total


def solid_table(stages: Tensor) -> Tensor:
    """Return (M, CODES) 1 where a code is solid and 0 where it is blood, of (M, 3) valve stages."""
    rows = [
        [float(shown(code, (a, b, c)) not in BLOOD) for code in range(CODES)]
        for a, b, c in stages.tolist()
    ]
    return torch.tensor(rows, device=stages.device)


def spread(field: Tensor, scanner: Scanner) -> Tensor:
    """Return (B, L, S) of what is known at the (B, 13, 19) nodes, by linear interpolation."""
    return torch.matmul(torch.matmul(scanner.nodes[0], field), scanner.nodes[1])


def hear(
    voxels: Tensor,
    at: Tensor,
    samples: Samples,
    solid: Tensor,
    settings: Settings,
    shadow: Tensor,
    scanner: Scanner,
    seeds: Tensor,
) -> Tensor:
    """Return the (B, 2, L, S) complex echoes before the point spread function.

    Args:
        voxels: flat int64 voxels of all hearts.
        at: (B,) first voxel of each row's heart.
        samples: where the samples lie.
        solid: (B, CODES) of the rows' valves, see `solid_table`.
        settings: of the rows.
        shadow: (B, L, S) dB that ribs and lung take from the sound on its way there.
        scanner: what all rows share.
        seeds: (B,) of the frames.
    """  # fmt: skip
    count = len(at)
    index = samples.voxel + at.view(-1, 1, 1)
    packed = voxels.index_select(0, index.flatten())
    shape = samples.voxel.shape
    levels = packed.view(torch.int8).view(*shape, 8)
    last = packed.view(torch.uint8).view(*shape, 8)[..., 7].to(torch.int32)
    code = (last & (CODES - 1)).add_(
        torch.arange(0, count * CODES, CODES, device=at.device, dtype=torch.int32).view(-1, 1, 1)
    )
    firm = solid.flatten().index_select(0, code.flatten()).view(shape)
    incidence = levels[..., 4].to(torch.float32) * samples.way[:, 0]
    incidence.addcmul_(levels[..., 5].to(torch.float32), samples.way[:, 1])
    incidence.addcmul_(levels[..., 6].to(torch.float32), samples.way[:, 2])
    incidence.mul_(firm).mul_((2.0**-BITS / settings.step).float().view(-1, 1, 1))
    strength = incidence.abs()
    # dB more than in soft tissue, which the TGC undoes
    extra = (last >> 6).to(torch.float32).mul_(ATTENUATIONS[1]).add_(ATTENUATIONS[0])
    loss = extra.mul_(settings.loss).add_(strength, alpha=SPECULAR_LOSS)
    loss.sub_(samples.air, alpha=AIR_LOSS).add_(shadow)
    received = loss.cumsum(-1).sub_(loss).mul_(-2.0).add_(settings.along).add_(scanner.sideways)
    received.mul_(math.log(10.0) / 20.0).exp_().mul_(SCATTERER_STEP)
    return _echoes(packed, shape, incidence, strength, firm, received, settings, scanner, seeds)


def _echoes(
    packed: Tensor, shape: torch.Size, incidence: Tensor, strength: Tensor, firm: Tensor,
    received: Tensor, settings: Settings, scanner: Scanner, seeds: Tensor,
) -> Tensor:  # fmt: skip
    """Join what scatterers, interfaces and fresh blood send back."""
    scatterers = packed.view(torch.int16).view(*shape, 4)
    specular = incidence.mul_(strength).mul_(SPECULAR_GAIN * SPECULAR_GAIN / SCATTERER_STEP)
    across = strength.mul_((1.0 - ALONG_SHEET) / SHEET).clamp_max_(1.0 - ALONG_SHEET)
    across.add_(ALONG_SHEET).mul_(firm)
    fresh = _run(scanner.beams, derive(seeds, 13), torch.Size((len(seeds), 2, *shape[1:])))
    flowing = torch.sub(1.0, firm).mul_(settings.blood * (BLOOD_GAIN / SCATTERER_STEP))
    echoes = fresh.mul_(flowing.unsqueeze(1))
    real, imaginary = echoes.unbind(1)
    real.add_(specular).addcmul_(scatterers[..., 0].to(torch.float32), across).mul_(received)
    imaginary.addcmul_(scatterers[..., 1].to(torch.float32), across).mul_(received)
    return echoes


def picture(
    echoes: Tensor, coupling: Tensor, settings: Settings, scanner: Scanner, seeds: Tensor
) -> Tensor:
    """Turn echoes into (B, L, S) gray 0-255: point spread, face, looks, log compression."""
    gain = coupling.unsqueeze(-1)
    power, level = None, None
    for look in range(PROBE.looks):
        field = _spread(echoes, scanner, look).mul_(gain.unsqueeze(1))
        if level is None:  # both looks have the same mean power around
            level = _level(field, gain, settings, scanner)
        noise = _run(scanner.beams, derive(seeds, 17 + look), field.shape)
        lifted = (1.0 - 0.65 * gain).unsqueeze(1)
        field.addcmul_(noise, level).addcmul_(scanner.beams.clutter, lifted)
        found = echo_power(field).clamp_min_(FAINTEST)
        power = found if power is None else power.mul_(found)  # the looks' mean in decibels
    assert power is not None
    shade = power.log10_().mul_(settings.contrast / PROBE.looks).add_(settings.lift)
    # The gray map as one exponential: a power whose exponent differs from row to row is slow.
    return shade.clamp_(1e-6, 1.0).log_().mul_(settings.curve).exp_().mul_(255.0)


def _spread(echoes: Tensor, scanner: Scanner, look: int) -> Tensor:
    """Blur (B, 2, L, S) echoes with the point spread function, as `acoustics.form_image` does."""
    beams = scanner.beams
    if look:
        cos, sin = beams.turn[look]
        real, imaginary = echoes.unbind(1)
        echoes = torch.stack([real * cos - imaginary * sin, real * sin + imaginary * cos], 1)
    field = shifted(echoes, scanner.pulse, 3).flatten(0, 1)
    blurred = torch.bmm(beams.lateral_far.expand(len(field), -1, -1), field)
    shallow = field[..., : len(beams.near)]
    near = torch.bmm(beams.lateral_near.expand(len(field), -1, -1), shallow)
    blurred[..., : len(beams.near)].lerp_(near, beams.near)
    return blurred.mul_(SPECKLE_GAIN).view(echoes.shape)


def _level(field: Tensor, gain: Tensor, settings: Settings, scanner: Scanner) -> Tensor:
    """Return the (B, 1, L, S) amplitude of all that has lost its phase.

    That is multiple scattering, which has the mean power of the echoes around, reverberation under
    the face, and electronic noise.
    """
    around = torch.matmul(scanner.veil[0], torch.matmul(echo_power(field), scanner.veil[1]))
    around = spread(around * settings.veil, scanner)
    around.add_(settings.hiss).addcmul_(settings.ringing, gain.square())
    return around.mul_(0.5).sqrt_().unsqueeze(1)


def _run(beams: Beams, seeds: Tensor, shape: torch.Size) -> Tensor:
    """Return standard normal numbers of a (B, ...) shape, a run of the bank for each seed."""
    size = shape[1:].numel()
    start = derive(seeds, 11).remainder(NOISE_BANK - size)
    return beams.noise.unfold(0, size, 1).index_select(0, start).view(shape)


def convert(
    polar: Tensor,
    pixels: Tensor,
    covered: Tensor,
    settings: Settings,
    scanner: Scanner,
    seeds: Tensor,
) -> Tensor:
    """Turn (B, L, S) gray 0-255 into (B, 128, 128) uint8 images; `pixel_map` gives two of them.

    What a scanner's filters leave is as fine as the picture, at any depth: the grain comes last.
    """
    along, across = scanner.smoothing
    polar = shifted(shifted(polar.unsqueeze(1), along, 3), across, 2).mul_(scanner.level)
    matrix, share = scanner.apex
    near = polar[..., : len(share)]
    near.lerp_(torch.matmul(matrix, near), share)
    grain = _run(scanner.beams, derive(seeds, 29), polar.shape)
    polar.addcmul_(grain, settings.grain.unsqueeze(1))
    image = functional.grid_sample(polar, pixels, "bilinear", "zeros", align_corners=True)
    return image.squeeze(1).mul_(covered).add_(0.5).clamp_(0.0, 255.0).to(torch.uint8)


def pixel_map(half_angle: float) -> tuple[Tensor, Tensor, Tensor]:
    """Lay a sector of unit depth into the image: apex at the top centre, as wide as the image.

    Returns:
        (128, 128, 2) float32, for `grid_sample`: sample and beam of each pixel in -1 to 1, far off
        outside the sector; (16384,) int64, the nearest of the polar grid's samples, or the one
        past the last outside; and (128, 128) float32, the share of each pixel that lies in the
        sector, as scanners draw their edges.
    """
    place = torch.arange(IMAGE_SIZE, dtype=torch.float64)
    pixel = 2.0 * math.sin(half_angle) / IMAGE_SIZE
    lateral, axial = (place - (IMAGE_SIZE - 1) / 2) * pixel, (place.unsqueeze(1) + 0.5) * pixel
    radius, angle = (lateral.square() + axial.square()).sqrt(), torch.atan2(lateral, axial)
    inside = (angle.abs() <= half_angle) & (radius <= 1.0)
    beam = ((angle / half_angle + 1.0) / 2.0 * (PROBE.beams - 1)).clamp(0, PROBE.beams - 1)
    sample = (radius * PROBE.samples - 0.5).clamp(0, PROBE.samples - 1)
    scale = torch.tensor([PROBE.samples - 1, PROBE.beams - 1], dtype=torch.float64)
    grid = torch.stack([sample, beam], -1) / scale * 2.0 - 1.0
    to_edge = torch.minimum((half_angle - angle.abs()) * radius, 1.0 - radius) / pixel
    covered = (to_edge + 0.5).clamp(0.0, 1.0)
    grid[covered == 0.0] = -3.0
    nearest = beam.round() * PROBE.samples + sample.round()
    nearest[~inside] = PROBE.beams * PROBE.samples
    return grid.float(), nearest.long().flatten(), covered.float()
