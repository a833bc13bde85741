"""The tissue around a heart, as tiles that repeat without a seam: surroundings, liver, chest wall.

All that is random in a patient's voxels is drawn here, once, on a tile: the heart's own
scatterers are the tile's, too. In double, so that what is rounded to integers, and what lies on one
side of a threshold, is so on every processor.

A tile lies along its heart's axes, so what is drawn on it must have no direction of its own: who
saw one would know how the heart lies without seeing it. A tile is small, and of the waves that fit
it a whole number of times the long ones lie along its edges; fields are made of shorter ones.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from racines_data.patients.draws import exact_normal
from racines_data.patients.labels import BACKGROUND, CAVA, CHEST, LIVER, MATERIALS, SOFT
from racines_data.patients.patient import Patient
from racines_data.patients.volume import TILE, VOXEL
from racines_data.phantom.volume import (
    ALONG_SHEET,
    REFLECTOR_STEP,
    SCATTER_BLUR,
    SCATTERER_STEP,
)
from racines_data.randomness import derive

CONNECTIVE = 6.0, 0.09
"""What layers of connective tissue scatter more than what lies around, dB, and their impedance's
excess, MRayl."""

WAVES = 16.0, 28.0
"""Wavelengths of what varies slowly, mm."""
FINE = 1.5
"""Standard deviation of the blur of what varies finely, mm."""
LAYERED = 0.29
"""Standard deviation of the field whose zeros are layers."""


class Fields(NamedTuple):
    """Random fields of one patient on a tile of X x Y x Z voxels, each periodic."""

    scatter: Tensor  # (2, X, Y, Z) complex Gaussian scatterers of unit power
    slow: Tensor  # (X, Y, Z) standard normal, over centimetres
    fine: Tensor  # (X, Y, Z) standard normal, over 2-3 mm
    layers: Tensor  # (X, Y, Z) normal; sheets of tissue lie where it is about 0


def draw_fields(patient: Patient) -> Fields:
    """Draw the fields of a patient."""
    seed = derive(torch.tensor([patient.seed]), 811)
    scatter = torch.stack([smooth(_white(seed, TILE, 1 + i), SCATTER_BLUR) for i in range(2)])
    scatter = scatter / (scatter.square().sum(0).mean().sqrt())
    fine = smooth(_white(seed, TILE, 4), [FINE / edge for edge in VOXEL])
    return Fields(scatter, even(seed, 3), _unit(fine), LAYERED * even(seed, 7))


def _white(seed: Tensor, shape: tuple[int, int, int], stream: int) -> Tensor:
    return exact_normal(seed, math.prod(shape), stream).view(shape)


def _unit(field: Tensor) -> Tensor:
    return (field - field.mean()) / field.std()


def smooth(field: Tensor, sigma: float | Sequence[float]) -> Tensor:
    """Blur the last three axes with a Gaussian of `sigma` voxels, of each axis, round the edges."""
    each = [sigma] * 3 if isinstance(sigma, float | int) else sigma
    for axis, width in zip(range(-3, 0), each, strict=True):
        reach = max(1, math.ceil(2.5 * width))
        taps = torch.exp(-0.5 * (torch.arange(-reach, reach + 1) / width) ** 2)
        weights = (taps / taps.sum()).tolist()
        total = torch.zeros_like(field)
        for shift, weight in enumerate(weights, -reach):
            total.add_(field.roll(shift, axis), alpha=weight)
        field = total
    return field


def even(seed: Tensor, stream: int) -> Tensor:
    """Draw a standard normal field of slow waves that has no direction, (X, Y, Z) of a tile."""
    turns, power = slow_waves()
    draw = exact_normal(seed, 2 * len(turns), stream).view(2, -1) * power.sqrt()
    spectrum = torch.zeros(TILE, dtype=torch.complex128)
    spectrum[turns.unbind(1)] = torch.complex(draw[0], draw[1])
    return _unit(torch.fft.ifftn(spectrum).real)


@lru_cache(maxsize=1)
def slow_waves() -> tuple[Tensor, Tensor]:
    """Return (M, 3) int64 turns of waves along a tile's edges, and the (M,) power of each.

    They are those of `WAVES` that fit the tile, one of each pair of opposite ones. Their power has
    the same second moment in all directions; the weights come from the multiplicative algorithm of
    D-optimal designs (Silvey, Titterington and Torsney, 1978).
    """
    edges = torch.tensor([n * edge for n, edge in zip(TILE, VOXEL, strict=True)]).double()
    most = int(float(edges.max()) / WAVES[0]) + 1
    turns = torch.cartesian_prod(*[torch.arange(-most, most + 1)] * 3)
    half = (turns * turns.new_tensor([most * 4 * most * 4, most * 4, 1])).sum(1) > 0
    wave = turns / edges
    length = wave.norm(dim=1).reciprocal()
    kept = half & (length >= WAVES[0]) & (length <= WAVES[1])
    turns, way = turns[kept], wave[kept] * length[kept].unsqueeze(1)
    power = torch.full((len(turns),), 1.0 / len(turns), dtype=torch.float64)
    for _ in range(100):
        moment = (power.unsqueeze(1) * way).T @ way
        power = power * ((way @ torch.linalg.inv(moment)) * way).sum(1) / 3.0
    return turns % torch.tensor(TILE), power


class Surroundings(NamedTuple):
    """What lies around a heart, on the tile."""

    echo: Tensor  # (X, Y, Z) dB
    impedance: Tensor  # MRayl
    attenuation: Tensor  # uint8 class
    packed: Tensor  # (X*Y*Z,) int64


def tile_of(patient: Patient, fields: Fields) -> Surroundings:
    """Make the surroundings: fat with uneven brightness and sheets of connective tissue."""
    tissues = patient.tissues
    layers = fields.layers.abs() < 0.30 * tissues.layers
    echo = tissues.surroundings + MATERIALS[BACKGROUND].echogenicity
    echo = echo + tissues.unevenness * fields.slow + tissues.grain * fields.fine
    echo = echo + CONNECTIVE[0] * layers
    impedance = MATERIALS[BACKGROUND].impedance + CONNECTIVE[1] * layers.double()
    attenuation = torch.where(layers, SOFT + 1, SOFT).to(torch.uint8)
    gradient = periodic_gradient(impedance)
    label = torch.full(echo.shape, BACKGROUND, dtype=torch.uint8)
    packed = pack(fields.scatter, smooth(echo, 0.6), gradient, label, attenuation)
    return Surroundings(echo, impedance, attenuation, packed)


def periodic_gradient(impedance: Tensor) -> Tensor:
    """Return the (3, X, Y, Z) gradient from voxel to voxel, in `REFLECTOR_STEP`, periodic."""
    field = smooth(impedance, 0.8)
    parts = [(field.roll(-1, axis) - field.roll(1, axis)) / 2.0 for axis in range(3)]
    return torch.stack(parts) / REFLECTOR_STEP


def pack(
    scatter: Tensor, echo: Tensor, gradient: Tensor, label: Tensor, attenuation: Tensor
) -> Tensor:
    """Join fields of one shape (X, Y, Z) to (X*Y*Z,) int64 voxels; see `volume`.

    Args:
        scatter: (2, X, Y, Z) unit scatterers.
        echo: backscatter, dB against myocardium; -inf scatters nothing.
        gradient: (3, X, Y, Z) impedance from voxel to voxel, in `REFLECTOR_STEP`.
        label: uint8 codes.
        attenuation: uint8 classes.
    """
    packed = torch.empty((*echo.shape, 8), dtype=torch.uint8)
    amplitude = torch.exp(echo * (math.log(10.0) / 20.0)) / SCATTERER_STEP
    echoes = (scatter * amplitude).round_().clamp_(-32767, 32767).to(torch.int16)
    packed[..., 0:4] = echoes.movedim(0, -1).contiguous().view(torch.uint8)
    turned = gradient.round().clamp_(-127, 127).to(torch.int8)
    packed[..., 4:7] = turned.movedim(0, -1).view(torch.uint8)
    packed[..., 7] = label | (attenuation << 6)
    return packed.view(torch.int64).reshape(-1)


def liver_tile(patient: Patient, fields: Fields) -> Tensor:
    """Return the (X*Y*Z,) int64 voxels of liver: even and fine, with vessels."""
    seed = derive(torch.tensor([patient.seed]), 823)
    slow = _unit(smooth(_white(seed, TILE, 1), 2.6))
    vessels = slow > 1.75
    echo = patient.tissues.liver + 0.8 * slow - 24.0 * vessels
    rim = smooth(vessels.double(), 1.0)
    echo = torch.where(vessels, echo, echo + 9.0 * rim)
    gradient = periodic_gradient(1.66 - 0.015 * vessels.double())
    label = torch.where(vessels, CAVA, LIVER).to(torch.uint8)
    attenuation = torch.full(TILE, SOFT, dtype=torch.uint8)
    return pack(fields.scatter / ALONG_SHEET, smooth(echo, 0.5), gradient, label, attenuation)


def chest_tile(patient: Patient, fields: Fields) -> Tensor:
    """Return the (X*Y*Z,) int64 voxels of the chest wall: skin, fat, fascia, muscle, fascia.

    The third axis goes from the skin through the wall, whatever its thickness; layers wave.
    """
    seed = derive(torch.tensor([patient.seed]), 829)
    wave = _unit(smooth(_white(seed, TILE, 1), 4.0))[..., :1]
    depth = (torch.arange(TILE[2]) + 0.5) / TILE[2] + 0.022 * wave
    fat, slow = patient.chest.fat, _unit(smooth(_white(seed, TILE, 2), 2.0))
    stripes = torch.sin(2.0 * math.pi * (depth * 9.0 + 0.25 * slow))
    echo = torch.where(depth < fat, -13.0 + 3.0 * slow, -11.0 + 4.0 * stripes + 1.5 * slow)
    edges = ((0.06, 8.0), (fat, 9.0), (0.55 + 0.45 * fat, 6.0), (0.94, 9.0))
    impedance = torch.full(TILE, 1.60, dtype=torch.float64)
    for place, lift in edges:
        line = torch.exp(-0.5 * ((depth - place) / 0.022).square())
        echo = echo + (lift + 5.0) * line
        impedance = impedance + 0.05 * line
    gradient = periodic_gradient(impedance)
    label = torch.full(TILE, CHEST, dtype=torch.uint8)
    attenuation = torch.full(TILE, SOFT, dtype=torch.uint8)
    return pack(fields.scatter / ALONG_SHEET, echo, gradient, label, attenuation)
