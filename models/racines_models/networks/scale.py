"""How large a pixel is, from posed frames alone: where two slices cross they show the same.

A scanner says it; posed images alone do not. The side at which frames of one sweep agree best where
they cross, or nearly do, is the true one but for a few hundredths on simulated patients.
"""

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from racines_data.geometry import Pose
from racines_data.imaging import IMAGE_SIZE
from racines_models.networks.scouting import nearest_frames, places, relative, sampled

SMALLEST, LARGEST = 0.0013, 0.0027
"""Sides that are tried, m: sectors 14 to 28 cm deep."""
TRIED = 15, 9
"""Sides tried, evenly; then so many between the neighbours of the best."""
EVERY = 4
"""One of so many frames is held beside others."""
OTHERS, APART = 12, 3
"""Frames that it is held beside: every third of its nearest, since the nearest says the least."""
CROSSING = 0.004
"""Distance from a frame's plane, m, at which a place counts by exp(-1/2)."""


def pixel_side(images: Tensor, pose: Pose) -> float:
    """Return the side of a pixel, m, of (S, 64, 64) float frames of a sweep at (S,) poses."""
    pixel, reach = 0.5 * (SMALLEST + LARGEST), 0.5 * (LARGEST - SMALLEST)
    for count in TRIED:
        sides = torch.linspace(pixel - reach, pixel + reach, count).tolist()
        found = torch.stack([agreement(images, pose, side) for side in sides])
        pixel, reach = sides[int(found.argmax())], 2.0 * reach / (count - 1)
    return pixel


def agreement(images: Tensor, pose: Pose, pixel: float) -> Tensor:
    """Return the correlation of frames with others, weighed by how nearly their planes meet."""
    scan = Pose(pose.position.unsqueeze(0), pose.rotation.unsqueeze(0))
    some = torch.arange(0, len(images), EVERY)
    own = Pose(*(part[some] for part in pose))
    near, _ = nearest_frames(scan, torch.zeros_like(some), own, OTHERS * APART + 1)
    near = near[:, 1::APART]
    small = avg_pool2d(images.unsqueeze(1), 2)
    size = small.shape[-1]
    middle = (torch.arange(size) + 0.5) * (IMAGE_SIZE / size)
    axial, lateral = torch.meshgrid(middle, middle - IMAGE_SIZE / 2, indexing="ij")
    grid = torch.stack([lateral, axial]).expand(len(some), -1, -1, -1) * pixel
    at = places(*relative(own, Pose(*(part[near] for part in pose))), grid)
    side = torch.full((len(some), 1, 1, 1), pixel)
    lit = small.amax(0, keepdim=True).gt(0).float()
    seen = sampled(small[near.flatten()], at, side).view(len(some), -1, size, size)
    inside = sampled(lit.expand(near.numel(), -1, -1, -1), at, side).view_as(seen)
    weight = torch.exp(-0.5 * (at[:, :, 1] / CROSSING).square()) * inside * lit[0]
    weight = weight / weight.sum().clamp_min(1e-9)
    first, second = (x - (weight * x).sum() for x in (seen, small[some].expand_as(seen)))
    power = (weight * first.square()).sum() * (weight * second.square()).sum()
    return (weight * first * second).sum() / power.clamp_min(1e-12).sqrt()
