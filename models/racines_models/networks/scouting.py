"""A network that looks, for each cell of a slice that is asked for, into the frames of a scout.

    cell of the asked slice ──> its place in space ──> where that lies in each frame, how far off
    what the frames show there, and how far off it is ──> attention over frames ──> image

Poses enter as one probe against another alone, so that nothing hangs on where a patient lies. That
each cell looks where its own place would be seen, and weighs what it finds there by learned scores,
follows Wang et al., IBRNet: Learning Multi-View Image-Based Rendering, 2021; a frame of ultrasound
is a slice, so the distance from its plane takes the place of the distance along a ray.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import (
    avg_pool2d,
    grid_sample,
    pixel_shuffle,
    pixel_unshuffle,
    silu,
    softplus,
)

from racines_data.geometry import Pose, matmul3, pose_keys, rotate
from racines_data.imaging import IMAGE_SIZE
from racines_models.networks.unet import CELL, GRID, Block

SIDE = 64
"""Pixels along a side of the frames that are looked into; what is drawn has all 128."""
FOLD = SIDE // GRID
GRAYS = FOLD * FOLD
"""Gray levels of a frame that a cell looks at."""
HALF = SIDE / 2
GEOMETRY = 11
"""Numbers that say how a frame lies to a cell."""
VALUES = 6
"""Numbers that a head gathers besides gray levels."""
NEAR = 4
"""Nearest frames whose distances the decoder is told."""
METRES_PER_RADIAN = 0.07
"""What a turn weighs against a shift when the nearest frames are chosen."""
OFF = (0.001, 0.002, 0.004, 0.008)
"""Distances from a frame's plane, m, at which a head's trust in it begins to fall."""
HEADS = len(OFF)
FIRST = 2
"""The head that the image is guessed by before anything is learned."""
OUTSIDE = 30.0
"""By how much less a frame is trusted where it shows nothing."""
LEAST = 0.01
"""Smallest deviation of a pixel, black 0 and white 1."""


class Scouts(NamedTuple):
    """What is known of G patients, S frames each."""

    images: Tensor
    """(G, S, 64, 64) float32, black 0 and white 1."""
    poses: Pose
    """(G, S)"""
    lit: Tensor
    """(G, 128, 128) float32, 1 where some frame is not black."""
    pixel: Tensor
    """(G,) m, the side of a pixel of the full image."""

    def of(self, rows: Tensor) -> "Scouts":
        """Return those of (N,) of the patients."""
        poses = Pose(*(each[rows] for each in self.poses))
        return Scouts(self.images[rows], poses, self.lit[rows], self.pixel[rows])

    def without(self, frames: Tensor) -> "Scouts":
        """Return them without the (S,) bool frames of each."""
        kept = (~frames).to(self.images.device)
        poses = Pose(*(each[:, kept] for each in self.poses))
        return self._replace(images=self.images[:, kept], poses=poses)

    def on(self, device: str) -> "Scouts":
        """Return them on a device."""
        held = (each.to(device) for each in (self.images, self.lit, self.pixel))
        images, lit, pixel = held
        return Scouts(images, self.poses.to(device), lit, pixel)


class Painted(NamedTuple):
    """Images of B poses, black 0 and white 1."""

    mean: Tensor
    """(B, 128, 128)"""
    deviation: Tensor
    """(B, 128, 128) of what is seen there, about the mean."""
    nearest: Tensor
    """(B,) int64, the nearest frame of the patient's scout."""


class Seen(NamedTuple):
    """What K frames show at the places of B asked slices."""

    raw: Tensor
    """(B, K, 4, 32, 32) gray levels, folded."""
    geometry: Tensor
    """(B, K, 11, 32, 32)"""
    off: Tensor
    """(B, K, 32, 32) m from the frame's plane."""
    inside: Tensor
    """(B, K, 32, 32) in 0-1, whether the place lies in the frame."""
    distances: Tensor
    """(B, K) m."""
    nearest: Tensor
    """(B,)"""


class ScoutNetwork(nn.Module):
    """Attention over the nearest frames of a scout, then convolutions over the asked image."""

    cells: Tensor
    fine: Tensor

    def __init__(self, width: int, frames: int, more: int = 0, about: int = 0) -> None:
        """Build with `width` channels at 32×32 cells, and so many nearest frames.

        The decoder may be told `more` numbers a cell, and so many `about` an image.
        """
        super().__init__()
        self.frames = frames
        self.score = nn.Sequential(
            nn.Conv2d(GRAYS + GEOMETRY + 2, 24, 3, padding=1), nn.SiLU(),
            nn.Conv2d(24, HEADS * (1 + VALUES), 1),
        )  # fmt: skip
        self.log_off = nn.Parameter(torch.tensor(OFF).log())
        self.decoder = Decoder(HEADS * (GRAYS + VALUES + 2) + 4 + more, width, NEAR + 1 + about)
        # In pixels of the full image, from the apex.
        for size, name in ((GRID, "cells"), (SIDE, "fine")):
            middle = (torch.arange(size) + 0.5) * (IMAGE_SIZE / size)
            axial, lateral = torch.meshgrid(middle, middle - IMAGE_SIZE / 2, indexing="ij")
            self.register_buffer(name, torch.stack([lateral, axial]), persistent=False)

    def forward(
        self, scouts: Scouts, owner: Tensor, pose: Pose, more: Sequence[Tensor] = ()
    ) -> Painted:
        """Paint (B,) poses of the patients that (B,) `owner` names.

        `more` has the (B, more, 32, 32) and (B, about) numbers that the decoder is told besides.
        """
        with torch.no_grad():
            seen = self._look(scouts, owner, pose)
        joined, guess = self._attend(seen)
        lit = scouts.lit[owner]
        cells = avg_pool2d(lit.unsqueeze(1), CELL)
        place = (self.cells / IMAGE_SIZE).expand(len(owner), -1, -1, -1)
        about = [seen.distances[:, :NEAR] / 0.02, scouts.pixel[owner, None] / 0.002]
        found = torch.cat([joined, place, cells, *more[:1]], 1)
        change, spread = self.decoder(found, torch.cat([*about, *more[1:]], 1))
        guess = guess.repeat_interleave(CELL // FOLD, 2).repeat_interleave(CELL // FOLD, 3)
        mean = (guess + pixel_shuffle(change, CELL)).squeeze(1) * lit
        deviation = softplus(pixel_shuffle(spread, CELL).squeeze(1) - 3.0)
        return Painted(mean, LEAST + deviation, seen.nearest)

    def _look(self, scouts: Scouts, owner: Tensor, pose: Pose) -> Seen:
        """Return what the near frames show at the places of the asked slices."""
        near, distances = nearest_frames(scouts.poses, owner, pose, self.frames)
        rows = (owner.unsqueeze(1) * scouts.images.shape[1] + near).flatten()
        others = Pose(*(x.flatten(0, 1)[rows].unflatten(0, near.shape) for x in scouts.poses))
        turn, shift = relative(pose, others)
        pixel = scouts.pixel[owner].view(-1, 1, 1, 1)
        fine, coarse = (places(turn, shift, each * pixel) for each in (self.fine, self.cells))
        frames = scouts.images.flatten(0, 1)[rows].unsqueeze(1)
        raw = pixel_unshuffle(sampled(frames, fine, pixel), FOLD).unflatten(0, near.shape)
        lit = avg_pool2d(scouts.lit.unsqueeze(1), 2)[owner].repeat_interleave(near.shape[1], 0)
        inside = sampled(lit, coarse, pixel).unflatten(0, near.shape).squeeze(2)
        lateral, off, axial = coarse.unbind(2)
        own = self.cells * pixel
        of_cells = [off / 0.01, (-off.abs() / 0.002).exp(), (-off.abs() / 0.006).exp(), inside]
        of_cells += [(lateral - own[:, :1]) / 0.03, (axial - own[:, 1:]) / 0.03]
        of_frames = [
            distances / 0.02,
            *(turn[..., i, k] for i, k in ((2, 2), (1, 1), (0, 2), (1, 2))),
        ]
        spread = torch.stack(of_frames, 2)[..., None, None].expand(-1, -1, -1, GRID, GRID)
        geometry = torch.cat([torch.stack(of_cells, 2), spread], 2)
        return Seen(raw, geometry, off, inside, distances, near[:, 0])

    def _attend(self, seen: Seen) -> tuple[Tensor, Tensor]:
        """Return (B, C, 32, 32) of what is found, and the (B, 1, 64, 64) guess of the image."""
        trust = -0.5 * (seen.off.unsqueeze(2) / self.log_off.exp().view(-1, 1, 1)).square()
        trust = trust.clamp_min(-OUTSIDE) - OUTSIDE * (1.0 - seen.inside.unsqueeze(2))
        first = trust[:, :, FIRST : FIRST + 1].softmax(1)
        about = (first * seen.raw).sum(1, keepdim=True)
        apart = seen.raw - about
        tokens = [seen.raw, seen.geometry, apart.mean(2, keepdim=True)]
        tokens += [about.mean(2, keepdim=True).expand(-1, seen.raw.shape[1], -1, -1, -1)]
        told = self.score(torch.cat(tokens, 2).flatten(0, 1)).unflatten(0, seen.off.shape[:2])
        weight = (told[:, :, :HEADS] + trust).softmax(1)
        grays = [(weight[:, :, head : head + 1] * seen.raw).sum(1) for head in range(HEADS)]
        values = told[:, :, HEADS:].unflatten(2, (HEADS, VALUES))
        found = (weight.unsqueeze(3) * values).sum(1).flatten(1, 2)
        far = (weight * seen.off.abs().unsqueeze(2)).sum(1) / 0.01
        known = (weight * seen.inside.unsqueeze(2)).sum(1)
        spread = ((first * apart.square()).sum(1).mean(1, keepdim=True) + 1e-6).sqrt()
        guess = pixel_shuffle(grays[FIRST], FOLD)
        return torch.cat([*grays, found, far, known, spread], 1), guess


class Decoder(nn.Module):
    """What was found to the image: two levels of cells, each with convolutions around a skip."""

    def __init__(self, inputs: int, width: int, about: int) -> None:
        super().__init__()
        low, high, embedding = width, 2 * width, 64
        self.about = nn.Sequential(nn.Linear(about, embedding), nn.SiLU())
        self.enter = nn.Conv2d(inputs, low, 1)
        self.down = Block(low, embedding)
        self.to_high = nn.Conv2d(low, high, 2, stride=2)
        self.middle = nn.ModuleList(Block(high, embedding) for _ in range(2))
        self.from_high = nn.ConvTranspose2d(high, low, 2, stride=2)
        self.up = Block(low, embedding)
        self.leave = nn.Conv2d(low, 2 * CELL * CELL, 3, padding=1)
        for weight in self.leave.parameters():
            nn.init.zeros_(weight)

    def forward(self, found: Tensor, about: Tensor) -> tuple[Tensor, Tensor]:
        """Return (B, 16, 32, 32) changes of a guess, and numbers of deviations."""
        told = self.about(about)
        low = self.down(self.enter(found), told)
        high = self.to_high(low)
        for block in self.middle:
            high = block(high, told)
        low = self.up(self.from_high(high) + low, told)
        change, spread = self.leave(silu(low)).chunk(2, 1)
        return change, spread


def nearest_frames(poses: Pose, owner: Tensor, pose: Pose, count: int) -> tuple[Tensor, Tensor]:
    """Return (B, K) nearest frames of each pose's own scout, and (B, K) distances, m."""
    held = pose_keys(Pose(*(part.flatten(0, 1) for part in poses)), METRES_PER_RADIAN)
    held = held.unflatten(0, poses.position.shape[:2])[owner]
    apart = (held - pose_keys(pose, METRES_PER_RADIAN).unsqueeze(1)).square().sum(-1).sqrt()
    found = apart.topk(min(count, apart.shape[1]), largest=False)
    return found.indices, found.values


def relative(pose: Pose, others: Pose) -> tuple[Tensor, Tensor]:
    """Return (B, K, 3, 3) turns and (B, K, 3) shifts, m, of (B,) probes in (B, K) others' axes."""
    inverse = others.rotation.transpose(-1, -2)
    shift = rotate(inverse, pose.position.unsqueeze(1) - others.position)
    return matmul3(inverse, pose.rotation.unsqueeze(1).expand_as(inverse)), shift


def places(turn: Tensor, shift: Tensor, grid: Tensor) -> Tensor:
    """Return (B, K, 3, H, W) places in the frames' axes, m, of a (B, 2, H, W) grid of slices."""
    lateral, axial = (each[:, None, None] for each in grid.unbind(1))
    right, beam = turn[..., 0, None, None], turn[..., 2, None, None]
    return shift[..., None, None] + right * lateral + beam * axial


def sampled(maps: Tensor, at: Tensor, pixel: Tensor) -> Tensor:
    """Return (N, C, H, W) of (N, C, …) maps at (B, K, 3, H, W) places projected onto them.

    N is B · K; `pixel` is (B, 1, 1, 1), m.
    """
    half = IMAGE_SIZE / 2 * pixel
    grid = torch.stack([at[:, :, 0] / half, at[:, :, 2] / half - 1.0], -1)
    return grid_sample(maps, grid.flatten(0, 1), align_corners=False)


def shrink(images: Tensor) -> Tensor:
    """Return (…, 64, 64) float32, black 0 and white 1, of (…, 128, 128) gray levels."""
    return avg_pool2d(images.float() / 255.0, IMAGE_SIZE // SIDE)


def texture(images: Tensor) -> Tensor:
    """Return (N, H, W) grain of images, black 0 and white 1: their rest, locally of deviation 1."""
    x = images.unsqueeze(1)
    rest = x - avg_pool2d(x, 5, 1, 2, count_include_pad=False)
    size = avg_pool2d(rest.square(), 9, 1, 4, count_include_pad=False).sqrt()
    return (rest / (size + LEAST)).squeeze(1)
