"""Sector acoustics: what the probe hears along its beams, and how the scanner draws it.

The convolution model (Bamber & Dickinson 1980; Meunier & Bertrand 1995): complex scatterers fixed
in the block are sampled along each beam, weighted by what reaches them and returns (attenuation,
loss at interfaces, coupling), joined by specular echoes of interfaces hit head-on, and blurred by
a separable point spread function whose width is an angle across the beam and a length along it.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from racines_data.geometry import Pose
from racines_data.imaging import IMAGE_SIZE
from racines_data.phantom.config import ProbeConfig
from racines_data.phantom.volume import ALONG_SHEET, ATTENUATION_STEP, SCATTERER_STEP, SHEET, Volume
from racines_data.randomness import derive, normal, sample_seeds

SPECKLE_GAIN = 0.68  # undoes the blur's gain on correlated scatterers: myocardium is 1
SPECULAR_GAIN = 0.05  # echo of a head-on interface, per unit of packed impedance gradient
SPECULAR_LOSS = 0.02  # one-way loss at an interface, dB per unit of packed gradient
AIR_LOSS = 60.0  # one-way loss a centimetre outside the block, dB
LOOK_STEP = 1.6  # phase between sub-bands over one sigma of the pulse, rad: nearly uncorrelated
RINGING_DEPTH = 0.035  # depth at which reverberation has lost a factor e of its power, m
NEAR_FIELD = 0.025  # depth at which the near field's gain is a factor e closer to that in depth, m
STRIP = 24  # columns of a band matrix that are multiplied at once
VEIL_ANGLE, VEIL_DEPTH = 0.20, 0.020  # reach of multiple scattering: standard deviation, rad and m
NOISE_BANK = 1 << 20
REVERBERATION_SEED = 977


class Beams(NamedTuple):
    """The fixed polar grid of a probe and everything precomputed on it."""

    sin: Tensor  # (L,) lateral component of each beam's direction
    cos: Tensor
    depth: Tensor  # (S,) distance of each sample from the face, m
    elevation: Tensor  # (L, S) offset out of the plane, m: one draw a point for its thickness
    axial: Tensor  # (S / STRIP, W, STRIP) pulse from the right, see `strips_of`
    lateral_far: Tensor  # (L, L) beam profile at the focus with its side lobes, from the left
    lateral_near: Tensor
    veil_across: Tensor  # (L, L) from the left: the mean echo power around
    veil_along: Tensor  # (S, S) from the right
    near: Tensor  # (N,) share of the near profile, of the N samples that lie before the focus
    turn: Tensor  # (looks, 2, S) cosine and sine of each sub-band's phase against the first
    ringing: Tensor  # (S,) power of what bounces between the layers under the probe
    hiss: Tensor  # (S,) power of the electronic noise, as the TGC lifts it
    lift: Tensor  # (L, S) dB: the TGC, less the loss of steered beams and of the near field
    clutter: Tensor  # (2, L, S) reverberation of the face, fixed to the probe
    noise: Tensor  # (NOISE_BANK,) standard normal numbers; a frame reads a run of them


def make_beams(probe: ProbeConfig, gel_attenuation: float, device: torch.device) -> Beams:
    """Precompute the polar grid of a probe."""
    angle = torch.linspace(-probe.half_angle, probe.half_angle, probe.beams)
    step = probe.depth / probe.samples
    depth = (torch.arange(probe.samples) + 0.5) * step
    spread = normal(sample_seeds(1, 1), probe.beams * probe.samples)
    spread = spread.view(probe.beams, probe.samples).clamp(-2.0, 2.0)
    elevation = spread * (0.0006 + probe.elevation_sigma * (depth - probe.focus).abs())
    spacing = float(angle[1] - angle[0])
    sigma = probe.lateral_sigma / spacing
    share = ((probe.focus - depth) / probe.focus).clamp(0.0, 1.0)
    turn = torch.arange(probe.looks).unsqueeze(1) * (depth * (LOOK_STEP / probe.axial_sigma))
    tgc = 2.0 * gel_attenuation * probe.frequency * 100.0 * depth
    aside = probe.near_gain * torch.exp(-depth / NEAR_FIELD)
    aside = aside - probe.directivity * (angle / probe.half_angle).square().unsqueeze(1)
    lobes = probe.side_lobes * _profile(probe.beams, probe.side_lobe_sigma / spacing)
    beams = Beams(
        sin=angle.sin(),
        cos=angle.cos(),
        depth=depth,
        elevation=elevation,
        axial=strips_of(_profile(probe.samples, probe.axial_sigma / step)),
        lateral_far=_profile(probe.beams, sigma) + lobes,
        lateral_near=_profile(probe.beams, 2.2 * sigma) + lobes,
        veil_across=averaging(probe.beams, VEIL_ANGLE / spacing) * 10.0 ** (probe.haze / 10.0),
        veil_along=averaging(probe.samples, VEIL_DEPTH / step).T.contiguous(),
        near=share[share > 0.0],
        turn=torch.stack([turn.cos(), turn.sin()], 1),
        ringing=10.0 ** (probe.reverberation / 10.0) * torch.exp(-depth / RINGING_DEPTH),
        hiss=10.0 ** ((probe.noise + 0.62 * tgc) / 10.0),
        lift=tgc + aside,
        clutter=_clutter(probe, depth),
        noise=normal(sample_seeds(2, 1), NOISE_BANK)[0],
    )
    return Beams(*(x.to(device=device, dtype=torch.float32) for x in beams))


def strips_of(matrix: Tensor) -> Tensor:
    """Cut an (S, S) band matrix into (N, W, STRIP) columns with the W rows about their band."""
    size = len(matrix)
    step = STRIP if size % STRIP == 0 else size
    rows, columns = matrix.nonzero().unbind(1)
    reach = int((rows - columns).abs().max())
    width = min(size, step + 2 * reach)
    starts = [_first_row(at, reach, size, width) for at in range(0, size, step)]
    parts = (matrix[first : first + width, at * step : (at + 1) * step]
             for at, first in enumerate(starts))  # fmt: skip
    return torch.stack([*parts])


def _first_row(column: int, reach: int, size: int, width: int) -> int:
    """Return the first of the `width` rows of a strip that begins at a column."""
    return min(max(column - reach, 0), size - width)


def banded(field: Tensor, strips: Tensor) -> Tensor:
    """Multiply a (B, L, S) field from the right by a band matrix, see `strips_of`.

    A matrix product adds up from the first row to the last, and what lies beyond the band adds
    zeros: so the result is the dense product's, to the last bit.
    """
    count, width, step = strips.shape
    size = field.shape[-1]
    if count == 1:
        return torch.bmm(field, strips.expand(len(field), -1, -1))
    reach, parts = (width - step) // 2, []
    for at, strip in enumerate(strips):
        first = _first_row(at * step, reach, size, width)
        seen = field[..., first : first + width]
        parts.append(torch.bmm(seen, strip.expand(len(field), -1, -1)))
    return torch.cat(parts, -1)


def _profile(size: int, sigma: float) -> Tensor:
    """Return a symmetric banded matrix of Gaussian rows with unit energy (keeps speckle power)."""
    matrix = gaussian_matrix(size, sigma, 4)
    return matrix / matrix.square().sum(1, keepdim=True).sqrt()


def _clutter(probe: ProbeConfig, depth: Tensor) -> Tensor:
    """Ringing of the face: bands that repeat and die away, with a little fixed speckle."""
    bands = 0.6 + 0.4 * torch.cos(2.0 * math.pi * depth / 0.0048)
    decay = 1.6 * torch.exp(-depth / 0.0042) + 0.05 * torch.exp(-depth / 0.016)
    speckle = normal(sample_seeds(REVERBERATION_SEED, 2), probe.beams * probe.samples)
    speckle = speckle.view(2, probe.beams, probe.samples)
    phase = torch.tensor([1.0, 0.0]).view(2, 1, 1)
    return (phase + 0.5 * speckle) * bands * decay


def sample_echoes(volume: Volume, beams: Beams, probe: ProbeConfig, pose: Pose) -> Tensor:
    """Return the (B, 2, L, S) complex echoes of the block before the point spread function."""
    x, y, z = (pose.rotation[:, :, i] for i in range(3))
    sin, cos = beams.sin.view(1, -1, 1), beams.cos.view(1, -1, 1)
    direction = x.unsqueeze(1) * sin + z.unsqueeze(1) * cos
    index = _voxel_index(volume, beams, pose.position, direction, y)
    packed = volume.packed.index_select(0, index.flatten())
    scatterers = packed.view(torch.int16).view(*index.shape, 4)
    levels = packed.view(torch.int8).view(*index.shape, 8)
    attenuation = packed.view(torch.uint8).view(*index.shape, 8)[..., 7].to(torch.float32)
    incidence = levels[..., 4].to(torch.float32) * direction[..., 0:1]
    incidence.addcmul_(levels[..., 5].to(torch.float32), direction[..., 1:2])
    incidence.addcmul_(levels[..., 6].to(torch.float32), direction[..., 2:3])

    step_cm = 100.0 * probe.depth / probe.samples
    strength = incidence.abs()
    loss = attenuation * (ATTENUATION_STEP * probe.frequency * step_cm)
    loss.masked_fill_(attenuation >= 255.0, AIR_LOSS * step_cm)
    loss += SPECULAR_LOSS * strength
    received = loss.cumsum(-1).sub_(loss).mul_(2.0)
    received = torch.sub(beams.lift, received, out=received).mul_(math.log(10.0) / 20.0).exp_()
    received *= SCATTERER_STEP
    # A gradient seen at an angle loses to its cosine; the packed incidence is |g| cos θ already,
    # and the square makes the echo directional, as from a surface rough on a wavelength's scale.
    specular = incidence.mul_(strength).mul_(SPECULAR_GAIN * SPECULAR_GAIN / SCATTERER_STEP)
    across = strength.mul_((1.0 - ALONG_SHEET) / SHEET).clamp_max_(1.0 - ALONG_SHEET)
    across += ALONG_SHEET
    echoes = torch.empty((len(index), 2, *index.shape[1:]), device=index.device)
    real, imaginary = echoes.unbind(1)
    specular.addcmul_(scatterers[..., 0].to(torch.float32), across)
    torch.mul(specular, received, out=real)
    torch.mul(scatterers[..., 1].to(torch.float32), across, out=imaginary).mul_(received)
    return echoes


def _voxel_index(
    volume: Volume, beams: Beams, position: Tensor, direction: Tensor, elevation_axis: Tensor
) -> Tensor:
    """Return the (B, L, S) int64 voxel under each sample; outside falls on the border."""
    index = None
    for axis, size in enumerate(volume.shape):
        start = (position[:, axis] - volume.origin[axis]) / volume.voxel
        where = direction[..., axis : axis + 1] * (beams.depth / volume.voxel)
        aslant = (elevation_axis[:, axis] / volume.voxel).view(-1, 1, 1)
        where.addcmul_(beams.elevation, aslant).add_((start + 0.5).view(-1, 1, 1))
        where = where.clamp_(0.0, size - 1.0).to(torch.int32)
        index = where if index is None else index.mul_(size).add_(where)
    assert index is not None
    return index


def form_image(echoes: Tensor, beams: Beams, look: int = 0) -> Tensor:
    """Blur (B, 2, L, S) echoes with the point spread function, heard in one sub-band.

    A sub-band that lies apart by the inverse of the pulse's length hears the same scatterers with
    phases turned along the beam, hence another, independent speckle.
    """
    if look:
        cos, sin = beams.turn[look]
        real, imaginary = echoes.unbind(1)
        echoes = torch.empty_like(echoes)
        torch.mul(real, cos, out=echoes[:, 0]).sub_(imaginary * sin)
        torch.mul(real, sin, out=echoes[:, 1]).add_(imaginary * cos)
    field = echoes.flatten(0, 1)
    field = banded(field, beams.axial)
    blurred = torch.bmm(beams.lateral_far.expand(len(field), -1, -1), field)
    shallow = field[..., : len(beams.near)]
    near = torch.bmm(beams.lateral_near.expand(len(field), -1, -1), shallow)
    blurred[..., : len(beams.near)].lerp_(near, beams.near)
    return blurred.mul_(SPECKLE_GAIN).view(echoes.shape)


def add_face(
    field: Tensor, beams: Beams, probe: ProbeConfig, coupling: Tensor, seeds: Tensor
) -> Tensor:
    """Add coupling loss, reverberation and noise to (B, 2, L, S), in place; coupling is (B, L)."""
    gain = coupling.unsqueeze(1).unsqueeze(-1)
    size = field[0].numel()
    start = derive(seeds, 11).remainder(NOISE_BANK - size)
    noise = beams.noise.unfold(0, size, 1).index_select(0, start).view(field.shape)
    level = beams.ringing * coupling.square().unsqueeze(-1)
    level += beams.hiss
    field *= gain
    # What is scattered many times comes from all around and has lost its phase, as noise has.
    around = torch.bmm(echo_power(field), beams.veil_along.expand(len(field), -1, -1))
    around = torch.bmm(beams.veil_across.expand(len(field), -1, -1), around)
    noise *= around.add_(level).mul_(0.5).sqrt_().unsqueeze(1)
    field += beams.clutter * (1.0 - 0.65 * gain)
    return field.add_(noise)


def echo_power(field: Tensor) -> Tensor:
    """Return the (B, L, S) squared magnitude of (B, 2, L, S) complex echoes."""
    real, imaginary = field.unbind(1)
    return real.square().add_(imaginary.square())


class ScanConverter(NamedTuple):
    """Speckle reduction, then bilinear weights from the polar grid to the sector's pixels."""

    smooth_beams: Tensor  # (L, L) from the left
    smooth_samples: Tensor  # (S / STRIP, W, STRIP) from the right, see `strips_of`
    pixels: Tensor  # (P,) int64 flat indices of the pixels inside the sector
    taps: Tensor  # (4 * P,) int64 flat indices into the (beams, samples) grid
    weights: Tensor  # (4, P) float32

    def convert(self, polar: Tensor) -> Tensor:
        """Turn (B, beams, samples) gray levels 0-255 into (B, 128, 128) uint8 images."""
        count = len(polar)
        polar = banded(polar, self.smooth_samples)
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
        smooth_samples=strips_of(averaging(probe.samples, along, 3).T),
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
    pixel = probe.pixel_size
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
