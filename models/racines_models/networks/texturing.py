"""A flow from noise to what an image shows beside the expected one, given a scout's near frames.

    expected image, its deviation ─┐
    the two frames whose planes    ├──> U-Net, 64×64 and 32×32 cells ──> what is left, in deviations
    lie nearest to each pixel    ──┘

Where a frame of the scout passes within the thickness of the slice, it shows the very speckle of
the place; elsewhere speckle is drawn. Divided by its deviation, what is left beside the expected
image has the same size everywhere, so that one network of short reach can learn its texture.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d, pixel_shuffle, pixel_unshuffle, silu

from racines_data.geometry import Pose
from racines_data.imaging import IMAGE_SIZE
from racines_models.networks.scouting import (
    NEAR,
    Painted,
    Scouts,
    nearest_frames,
    places,
    relative,
    sampled,
)
from racines_models.networks.unet import Block, scales

FOLD = 2
"""Pixels along a cell's side."""
CELLS = IMAGE_SIZE // FOLD
GRAYS = FOLD * FOLD
CLOSEST = 2
"""Frames that are shown to each pixel."""
AMONG = 6
"""Nearest frames of which they are."""
OFF = (0.0005, 0.0015)
"""Distances from a frame's plane, m, at which its speckle is no more that of the place."""
LARGEST = 6.0
"""Deviations from the expected image that are told apart."""
TOLD = GRAYS + 4 + CLOSEST * (GRAYS + 2 + len(OFF))
"""Numbers a cell that the network is told."""
ABOUT = NEAR + 1
"""Numbers an image that it is told."""
WAVES = 4


class Near(NamedTuple):
    """What a scout shows nearest to each pixel of B asked slices, the closest frame first."""

    shown: Tensor
    """(B, 2, 128, 128) gray levels, black 0 and white 1."""
    off: Tensor
    """(B, 2, 128, 128) m from the frame's plane."""
    inside: Tensor
    """(B, 2, 128, 128) in 0-1, whether the place lies in the frame."""
    distances: Tensor
    """(B, 6) m, of the nearest frames."""


def closest(scouts: Scouts, frames: Tensor, owner: Tensor, pose: Pose) -> Near:
    """Find, pixel by pixel, the frames of a scout whose planes lie nearest to the place.

    Args:
        scouts: of G patients.
        frames: (G, S, 128, 128) float32 images of their scouts, black 0 and white 1.
        owner: (B,) the patient of each pose.
        pose: (B,) that are asked for.
    """
    near, distances = nearest_frames(scouts.poses, owner, pose, AMONG)
    rows = (owner.unsqueeze(1) * frames.shape[1] + near).flatten()
    others = Pose(*(x.flatten(0, 1)[rows].unflatten(0, near.shape) for x in scouts.poses))
    pixel = scouts.pixel[owner].view(-1, 1, 1, 1)
    middle = torch.arange(IMAGE_SIZE, device=pixel.device) + 0.5
    axial, lateral = torch.meshgrid(middle, middle - IMAGE_SIZE / 2, indexing="ij")
    at = places(*relative(pose, others), torch.stack([lateral, axial]) * pixel)
    lit = scouts.lit[owner].repeat_interleave(near.shape[1], 0).unsqueeze(1)
    held = torch.cat([frames.flatten(0, 1)[rows].unsqueeze(1), lit], 1)
    shown, inside = sampled(held, at, pixel).unflatten(0, near.shape).unbind(2)
    off = at[:, :, 1]
    order = (off.abs() + (inside < 0.5)).topk(CLOSEST, 1, largest=False).indices
    shown, off, inside = (each.gather(1, order) for each in (shown, off, inside))
    return Near(shown, off, inside, distances)


class TextureNetwork(nn.Module):
    """Foresees, from a noisy one, how an image deviates from the expected one, folded 2×2."""

    def __init__(self, width: int) -> None:
        """Build with `width` channels at 64×64 cells, a multiple of 8; twice as many at 32×32."""
        super().__init__()
        low, high, embedding = width, 2 * width, 2 * width
        self.time = nn.Linear(2 * WAVES + ABOUT, embedding)
        self.enter = nn.Conv2d(GRAYS + TOLD, low, 3, padding=1)
        self.down = Block(low, embedding)
        self.to_high = nn.Conv2d(low, high, 2, stride=2)
        self.middle = nn.ModuleList(Block(high, embedding) for _ in range(2))
        self.from_high = nn.ConvTranspose2d(high, low, 2, stride=2)
        self.up = Block(low, embedding)
        self.leave = nn.Conv2d(low, GRAYS, 3, padding=1)
        for weight in self.leave.parameters():
            nn.init.zeros_(weight)

    def forward(self, noisy: Tensor, time: Tensor, told: Tensor, about: Tensor) -> Tensor:
        """Return the (B, 4, 64, 64) deviations foreseen from noisy ones at (B,) times.

        `told` (B, 24, 64, 64) and `about` (B, 5) are those of `told_of`.
        """
        waves = time[:, None] * math.pi * 2.0 ** torch.arange(WAVES, device=time.device)
        film = silu(self.time(torch.cat([waves.sin(), waves.cos(), about], -1)))
        keep, change, size = (each[:, None, None, None] for each in scales(time, 1.0))
        low = self.down(self.enter(torch.cat([noisy / size, told], 1)), film)
        high = self.to_high(low)
        for block in self.middle:
            high = block(high, film)
        low = self.up(self.from_high(high) + low, film)
        return keep * noisy + change * self.leave(silu(low))


def told_of(painted: Painted, lit: Tensor, pixel: Tensor, near: Near) -> tuple[Tensor, Tensor]:
    """Return what the network is told of cells, (B, 24, 64, 64), and of images, (B, 5).

    Speckle is as wide as the beam, so that depth and direction count.

    Args:
        painted: (B,) expected images.
        lit: (B, 128, 128), 1 where the sector is.
        pixel: (B,) m, the side of a pixel.
        near: what the closest frames show.
    """
    mean, deviation = painted.mean.unsqueeze(1), painted.deviation.unsqueeze(1)
    apart = deviations(near.shown, mean, deviation) * near.inside
    small = [deviation.log() + 3.0, lit.unsqueeze(1), near.inside]
    small += [(near.off / OFF[-1]).clamp(-3.0, 3.0)]
    small += [(-0.5 * (near.off / each).square()).exp() * near.inside for each in OFF]
    middle = (torch.arange(IMAGE_SIZE, device=mean.device) + 0.5) / IMAGE_SIZE
    axial, lateral = torch.meshgrid(middle, middle - 0.5, indexing="ij")
    polar = torch.stack([torch.hypot(axial, lateral), torch.atan2(lateral, axial)])
    small += [polar.expand(len(mean), -1, -1, -1)]
    full = torch.cat([2.0 * mean - 1.0, apart / 2.0], 1)
    cells = torch.cat([folded(full), avg_pool2d(torch.cat(small, 1), FOLD)], 1)
    return cells, torch.cat([near.distances[:, :NEAR] / 0.02, pixel.unsqueeze(1) / 0.002], 1)


def deviations(image: Tensor, mean: Tensor, deviation: Tensor) -> Tensor:
    """Return by how many deviations an image is off the mean, up to `LARGEST`."""
    return ((image - mean) / deviation).clamp(-LARGEST, LARGEST)


def folded(images: Tensor) -> Tensor:
    """Return (B, 4 · C, 64, 64) of (B, C, 128, 128)."""
    return pixel_unshuffle(images, FOLD)


def unfolded(cells: Tensor) -> Tensor:
    """Return the (B, 128, 128) of (B, 4, 64, 64)."""
    return pixel_shuffle(cells, FOLD).squeeze(1)
