"""Bake an anatomy into voxels that a beam can be sampled from with one gather a point."""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from racines_data.phantom.anatomy import Anatomy
from racines_data.phantom.config import BlockConfig
from racines_data.randomness import normal, sample_seeds

ATTENUATION_STEP = 0.02  # dB/cm/MHz of one unit of the packed attenuation byte
SCATTERER_STEP = 5e-4  # amplitude of one unit of a packed scatterer; myocardium has 1, blood 0.02
SCATTER_BLUR = 0.5  # correlation of scatterers, voxels
REFLECTOR_STEP = 0.002  # impedance difference (MRayl a voxel) of one unit of a packed gradient byte
SHEET = 5.0  # length of a sheet's normal, packed gradient: too short to shine as a mirror
ALONG_SHEET = 0.5  # echo along a sheet against across (Mottley & Miller 1988: 5 to 6 dB)
COVER = 0.006, 0.014  # depth at which the cover lies, m


class Volume(NamedTuple):
    """Voxels of the block with a border of outside, packed to eight bytes each.

    Bytes 0-3: complex scatterer amplitude, two int16 in `SCATTERER_STEP`. Bytes 4-6: impedance
    gradient, three int8 in `REFLECTOR_STEP`. Byte 7: attenuation, uint8 in `ATTENUATION_STEP`.
    """

    packed: Tensor  # (X * Y * Z,) int64, z fastest, since beams run mostly along z
    shape: tuple[int, int, int]
    origin: Tensor  # (3,) float32 centre of voxel (0, 0, 0), base frame, m
    voxel: float


def bake(anatomy: Anatomy, block: BlockConfig) -> Volume:
    """Voxelise the block: tissue, scatterers of each, impedance steps, attenuation."""
    low, high = torch.tensor(block.minimum), torch.tensor(block.maximum)
    inner = ((high - low) / block.voxel).round().to(torch.int64).tolist()
    tissue = _tissue_grid(anatomy, low, inner, block.voxel)

    def spread(name: str) -> Tensor:
        return torch.tensor([getattr(each, name) for each in anatomy.tissues])[tissue]

    gradient = torch.stack(torch.gradient(blur(spread("impedance"), 0.8))).div_(REFLECTOR_STEP)
    sheets = spread("sheets")
    gradient += sheet_normals(gradient, sheets)
    scatter = _scatterers(inner, block.seed)
    echogenicity = spread("echogenicity") + spread("texture") * _slow_field(inner, block.seed)
    echogenicity += spread("grain") * _slow_field(inner, block.seed + 1, 2.5)
    amplitude = 10.0 ** (blur(echogenicity, 0.6) / 20.0)
    amplitude[~sheets] /= ALONG_SHEET  # what has no direction is never seen along one
    attenuation = spread("attenuation") + _cover(inner, block)
    shape = (inner[0] + 2, inner[1] + 2, inner[2] + 2)
    packed = torch.zeros((*shape, 8), dtype=torch.uint8)
    packed[..., 7] = 255  # outside: air, nothing passes
    core = packed[1:-1, 1:-1, 1:-1]
    scatter.mul_(amplitude).div_(SCATTERER_STEP)  # in place: grids of the whole block are large
    echoes = scatter.round_().clamp_(-32767, 32767).to(torch.int16)
    core[..., 0:4] = echoes.movedim(0, -1).contiguous().view(torch.uint8)
    bytes_ = gradient.round_().clamp_(-127, 127).to(torch.int8)
    core[..., 4:7] = bytes_.movedim(0, -1).contiguous().view(torch.uint8)
    core[..., 7] = (attenuation / ATTENUATION_STEP).round().clamp(0, 254).to(torch.uint8)
    origin = low - 0.5 * block.voxel
    return Volume(packed.view(torch.int64).reshape(-1), shape, origin, block.voxel)


def _tissue_grid(anatomy: Anatomy, low: Tensor, shape: list[int], voxel: float) -> Tensor:
    """Paint (X, Y, Z) tissue indices: every second voxel, then those near a change of tissue.

    A layer thinner than two voxels shows only where it lies beside another change.
    """
    coarse_shape = [(n + 1) // 2 for n in shape]
    index = [torch.arange(n) * 2.0 for n in coarse_shape]
    coarse = _paint(anatomy, low, voxel, torch.cartesian_prod(*index)).view(coarse_shape)
    around = coarse.to(torch.float32).view(1, 1, *coarse_shape)
    highest = functional.max_pool3d(around, 3, 1, 1)
    lowest = -functional.max_pool3d(-around, 3, 1, 1)
    tissue = _double(coarse, shape)
    where = _double((highest != lowest).view(coarse_shape), shape).nonzero()
    tissue[tuple(where.unbind(1))] = _paint(anatomy, low, voxel, where.to(torch.float32))
    return tissue


def _double(grid: Tensor, shape: list[int]) -> Tensor:
    for axis in range(3):
        grid = grid.repeat_interleave(2, axis)
    return grid[: shape[0], : shape[1], : shape[2]].contiguous()


def _paint(anatomy: Anatomy, low: Tensor, voxel: float, index: Tensor) -> Tensor:
    """Paint (M, 3) voxels by index, a chunk at a time to bound memory."""
    axes, origin = torch.tensor(anatomy.axes), torch.tensor(anatomy.origin)
    chunks = (low + (part + 0.5) * voxel - origin for part in index.split(1 << 18))
    return torch.cat([anatomy.paint(chunk @ axes.T) for chunk in chunks])


def _scatterers(shape: list[int], seed: int) -> Tensor:
    """Draw (2, X, Y, Z) complex Gaussian scatterers, correlated over about two voxels.

    The correlation makes speckle decorrelate over millimetres of motion, as a beam of finite
    width does, and not at the first voxel boundary. A blurred Gaussian field is Gaussian, so the
    envelope in homogeneous gel stays Rayleigh.
    """
    seeds = sample_seeds(seed, 2 * shape[0])
    noise = torch.cat([normal(seed, shape[1] * shape[2]) for seed in seeds.split(1)])
    field = blur(noise.reshape(2, *shape), SCATTER_BLUR)
    return field.div_(field.std() * math.sqrt(2.0))


def _slow_field(shape: list[int], seed: int, scale: float = 8.0) -> Tensor:
    """Draw an (X, Y, Z) standard normal field that varies over `scale` voxels."""
    coarse = [max(2, round(n / scale)) for n in shape]
    noise = normal(sample_seeds(seed + 1, 1), math.prod(coarse)).view(1, 1, *coarse)
    field = functional.interpolate(noise, shape, mode="trilinear", align_corners=True)[0, 0]
    return field / field.std()


def blur(grid: Tensor, sigma: float) -> Tensor:
    """Blur the last three axes with a Gaussian of `sigma` voxels, edges replicated."""
    radius = max(1, math.ceil(2.5 * sigma))
    taps = torch.exp(-0.5 * (torch.arange(-radius, radius + 1) / sigma) ** 2)
    weights = (taps / taps.sum()).tolist()
    # Shifted sums: a convolution would hold several copies of a grid that fills half a gigabyte.
    for axis in range(-3, 0):
        size = grid.shape[axis]
        first, last = grid.narrow(axis, 0, 1), grid.narrow(axis, size - 1, 1)
        padded = torch.cat([*[first] * radius, grid, *[last] * radius], axis)
        grid = padded.narrow(axis, 0, size) * weights[0]
        for shift, weight in enumerate(weights[1:], 1):
            grid.add_(padded.narrow(axis, shift, size), alpha=weight)
    return grid


def _cover(shape: list[int], block: BlockConfig) -> Tensor:
    """Return the (X, Y, Z) attenuation that an uneven cover adds, dB/cm/MHz."""
    extra = torch.zeros(shape)
    if block.cover > 0:
        patches = _slow_field([*shape[:2], 1], block.seed + 2, 12.0)
        top, bottom = (shape[2] - round(depth / block.voxel) for depth in COVER)
        extra[:, :, bottom:top] = (block.cover * patches).clamp_min(0.0)
    return extra


def sheet_normals(gradient: Tensor, sheets: Tensor) -> Tensor:
    """Return (3, X, Y, Z) normals of the walls inside anisotropic tissue, `SHEET` long, else 0.

    Muscle lies in sheets along the walls that it makes. A voxel's sheet is normal to the interfaces
    around it: the first axis of their structure tensor, on a grid of half the resolution.
    """
    pairs = (0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)
    # One product of whole grids at a time, and voxels in parts, bound the memory of a bake.
    coarse = blur(torch.cat([_halved(gradient[i] * gradient[j]) for i, j in pairs]), 2.0)
    normals = torch.zeros_like(gradient)
    for where in sheets.nonzero().split(1 << 18):
        xx, yy, zz, xy, xz, yz = coarse[:, *(where // 2).unbind(1)]
        tensor = torch.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], -1).view(-1, 3, 3)
        axis = torch.ones(len(where), 3, 1, dtype=gradient.dtype)
        for _ in range(8):  # power iteration
            axis = functional.normalize(tensor @ axis, dim=1)
        along, at = axis[..., 0].T, where.unbind(1)
        side = torch.where((along * gradient[:, *at]).sum(0) < 0, -SHEET, SHEET)
        normals[:, *at] = along * side
    return normals


def _halved(grid: Tensor) -> Tensor:
    return functional.avg_pool3d(grid[None, None], 2, ceil_mode=True)[0]
