# pyright: strict
"""Which voxel lies under each sample of each beam, in exact arithmetic.

    nodes of a coarse polar grid -> base frame -> chest gives way -> organ frame -> heartbeat
          double, then rounded to 1/256 voxel
    all samples between them, by weights in eighths: integers in float32, exact in any order
    voxel = floor; outside the box the tile, beyond the diaphragm the liver, near the skin the chest

A node has five coordinates: x, y, z in voxels of the box, depth under the skin in voxels of the
chest wall, and distance beyond the diaphragm. Rounded once, they are integers of 2⁻⁸, and samples
between nodes integers of 2⁻¹⁴: below 2²⁴ float32 holds each sum exactly, so that no sample falls to
another voxel on another processor.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from racines_data.geometry import Pose, rotate
from racines_data.patients.draws import exact_normal
from racines_data.patients.form import LIVER
from racines_data.patients.placement import SURFACE
from racines_data.patients.settings import PROBE, Settings
from racines_data.patients.volume import (
    BOX_BITS,
    CHEST_AT,
    CHEST_LEVELS,
    LIVER_AT,
    TILE_AT,
    VOXEL,
    to_voxels,
)
from racines_data.randomness import sample_seeds

SPACING = 8  # beams, and samples, from node to node
NODE_BITS, WEIGHT_BITS = 8, 3
BITS = NODE_BITS + 2 * WEIGHT_BITS  # of a sample's fraction
FARTHEST = 511.0  # voxels: what is farther than any sector is held here, so that sums stay exact
DIAPHRAGM = 1.5  # thickness, mm
DIAPHRAGM_LAYER = CHEST_LEVELS - 2  # of the chest wall: its brightest one stands for it, too
JITTER_BITS = 6


class Grid(NamedTuple):
    """The polar grid's nodes and how samples lie between them."""

    beam: Tensor  # (13,) float64, of the nodes: -1 to 1 over the sector
    sample: Tensor  # (19,) float64, of the nodes: samples from the face
    across: Tensor  # (96, 13) weights in eighths
    along: Tensor  # (19, 144) weights in eighths
    jitter: Tensor  # (96, 144) offset out of the plane, steps of 2^-6 of a sample's length


def make_grid(device: torch.device) -> Grid:
    """Lay out the nodes, and draw each sample's offset in the thickness of the slice."""
    beams, samples = PROBE.beams, PROBE.samples
    node_beam = torch.arange(0, beams + SPACING, SPACING, dtype=torch.float64)
    node_sample = torch.arange(0, samples + 1, SPACING, dtype=torch.float64)
    depth = (torch.arange(samples, dtype=torch.float64) + 0.5) * (PROBE.depth / samples)
    spread = exact_normal(sample_seeds(1, 1), beams * samples, 0).view(beams, samples)
    spread = spread.clamp(-2.0, 2.0)
    offset = spread * (0.0006 + PROBE.elevation_sigma * (depth - PROBE.focus).abs())
    jitter = (offset / (PROBE.depth / samples) * 2**JITTER_BITS).round()
    grid = Grid(
        beam=2.0 * node_beam / (beams - 1) - 1.0,
        sample=node_sample,
        across=_weights(beams, len(node_beam)),
        along=_weights(samples, len(node_sample)).T.contiguous(),
        jitter=jitter.float(),
    )
    return Grid(*(each.to(device) for each in grid))


def _weights(count: int, nodes: int) -> Tensor:
    """Return (count, nodes) weights in eighths of the two nodes beside each place."""
    place = torch.arange(count)
    below = (place // SPACING).clamp_max(nodes - 2)
    share = (place - below * SPACING).float()
    weights = torch.zeros(count, nodes)
    weights[place, below], weights[place, below + 1] = SPACING - share, share
    return weights


def base_nodes(pose: Pose, grid: Grid, settings: Settings) -> Tensor:
    """Return the (B, 13, 19, 3) nodes of float64 poses in the base frame, mm."""
    angle = grid.beam * settings.half_angle.unsqueeze(1)
    reach = (grid.sample + 0.5) * settings.step.unsqueeze(1)
    x, z = pose.rotation[:, None, :, 0], pose.rotation[:, None, :, 2]
    direction = x * angle.sin().unsqueeze(-1) + z * angle.cos().unsqueeze(-1)
    start = pose.position[:, None, None, :] * 1e3
    return start + direction.unsqueeze(2) * reach[:, None, :, None]


def coordinates(base: Tensor, beating: Tensor, settings: Settings) -> Tensor:
    """Return the (B, 5, 13, 19) coordinates of nodes, rounded, in steps of 2^-8.

    Args:
        base: (B, 13, 19, 3) mm, where the tissue under the nodes was before the probe pressed.
        beating: the same in the organ's frame, where it was at end diastole.
        settings: of the rows.
    """
    depth = (SURFACE * 1e3 - base[..., 2]) / settings.thickness.view(-1, 1, 1) * CHEST_LEVELS
    beyond = (beating * beating.new_tensor(LIVER)).sum(-1) - settings.diaphragm.view(-1, 1, 1)
    box = to_voxels(beating)
    parts = torch.stack([*box.unbind(-1), depth, beyond / DIAPHRAGM], 1)
    return (parts.clamp(-FARTHEST, FARTHEST) * 2**NODE_BITS).round()


class Samples(NamedTuple):
    """What is found under the samples of B rows."""

    voxel: Tensor  # (B, L, S) int32 in a heart's voxels
    way: Tensor  # (B, 3, L, S) float32, from sample to sample, steps of 2^-14 voxel
    air: Tensor  # (B, L, S) int32, -1 above the skin, else 0


def place_samples(nodes: Tensor, elevation: Tensor | None, grid: Grid) -> Samples:
    """Go from (B, 5, 13, 19) nodes to samples.

    Args:
        nodes: as `coordinates` gives them.
        elevation: (B, 3) voxels a sample's length along the probe's y axis; None: a slice without
            thickness.
        grid: the polar grid.
    """
    count = len(nodes)
    narrow = torch.matmul(grid.across, nodes.to(torch.float32).flatten(0, 1))
    where = torch.matmul(narrow, grid.along).view(count, 5, *narrow.shape[1:2], -1)
    way = torch.empty_like(where[:, :3])
    torch.sub(where[:, :3, :, 1:], where[:, :3, :, :-1], out=way[..., :-1])
    way[..., -1] = way[..., -2]
    places = [where[:, axis] for axis in range(5)]
    if elevation is not None:
        axis = (elevation * 2 ** (BITS - JITTER_BITS)).round().to(torch.float32)
        for i in range(3):
            places[i] = torch.addcmul(places[i], grid.jitter, axis[:, i].view(-1, 1, 1))
    voxel, air = _voxel(*(each.to(torch.int32) for each in places))
    return Samples(voxel, way, air)


def _choose(mask: Tensor, where_set: Tensor | int, where_not: Tensor) -> Tensor:
    """Select by a mask of -1 and 0, in place of `where_not`; several times faster than `where`."""
    return where_not.bitwise_xor_((where_not ^ where_set).bitwise_and_(mask))


def _below(value: Tensor, limit: int) -> Tensor:
    """Return -1 where int32 values are below a limit, else 0."""
    return (value - limit).bitwise_right_shift_(31)


def _voxel(x: Tensor, y: Tensor, z: Tensor, depth: Tensor, beyond: Tensor) -> tuple[Tensor, Tensor]:
    """Return the voxel of coordinates in steps of 2^-14, and where there is air.

    Masks are -1 and 0, and coordinates are cut from their bits where an index needs them.
    """
    height = z >> BITS
    box = (x & _field(BOX_BITS, BITS)) | ((y >> BOX_BITS) & _field(BOX_BITS, BITS - BOX_BITS))
    box.bitwise_or_(height & (2**BOX_BITS - 1))
    beside = (x | y | z).bitwise_right_shift_(BITS + BOX_BITS)
    beside = (beside | -beside).bitwise_right_shift_(31)
    liver, air = ~(beyond >> 31), depth >> 31
    diaphragm = _below(beyond, 1 << BITS).bitwise_and_(liver)
    wall = _below(depth, CHEST_LEVELS << BITS).bitwise_and_(~air)
    # Tiles share one layout, so that one index does for all; the wall's third axis is its depth.
    third = _choose(diaphragm, DIAPHRAGM_LAYER, height.bitwise_and_(CHEST_LEVELS - 1))
    third = _choose(wall, depth.bitwise_right_shift(BITS), third)
    chest = diaphragm.bitwise_or_(wall)
    kind = _choose(chest, CHEST_AT, liver.bitwise_and_(LIVER_AT - TILE_AT).add_(TILE_AT))
    tile = ((x >> 3) & _field(6, 11)).bitwise_or_((y >> 9) & _field(6, 5)).bitwise_or_(third)
    return _choose(beside.bitwise_or_(wall), tile.add_(kind), box), air


def _field(bits: int, at: int) -> int:
    """Return a mask of some bits from a place up."""
    return ((1 << bits) - 1) << at


def elevation_axis(pose: Pose, settings: Settings) -> Tensor:
    """Return (B, 3): voxels a sample's length along the probe's y axis, float64."""
    axis = rotate(settings.axes, pose.rotation[:, :, 1])
    return axis * settings.step.unsqueeze(1) / axis.new_tensor(VOXEL)
