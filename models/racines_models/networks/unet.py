"""A small U-Net that sees where each of its cells lies in the block."""

import math

import torch
from torch import Tensor, nn
from torch.nn.functional import relu, silu

from racines_data.geometry import POSITION, parameters_to_pose
from racines_data.imaging import IMAGE_SIZE
from racines_models.networks.layers import Conditioning

CELL = 4
"""Pixels along a cell's side: the image is folded into 32×32 cells of 16 pixels each."""
GRID = IMAGE_SIZE // CELL
LONGEST = 0.32
"""Wavelength of the coarsest features of place, m; each next one is half as long."""
SPREAD = 0.3
"""Standard deviation of images in [-1, 1] around what the pose tells early in training."""


def scales(time: Tensor, spread: float = SPREAD) -> tuple[Tensor, Tensor, Tensor]:
    """Return how much of a noisy image to keep, to change, and what to divide it by.

    `spread` is the standard deviation of the images around what is known of them.

    A linear guess of the image keeps the first share; the second is the guess's deviation, 0 at
    the end of the path, where speckle passes untouched. Preconditioning of Karras et al.,
    Elucidating the Design Space of Diffusion-Based Generative Models, 2022, on straight paths.
    """
    deviation = ((spread * time).square() + (1.0 - time).square()).sqrt()
    keep = time * spread**2 / deviation.square()
    return keep, (1.0 - time) * spread / deviation, deviation


class Place(nn.Module):
    """Features of the place in the block, in the base frame, that each cell of an image shows.

    The image plane is a square of `extent` metres below the probe, the probe at its top centre.
    Sines and cosines of the places' coordinates (Tancik et al., Fourier Features Let Networks
    Learn High Frequency Functions, 2020) let a millimetre matter. Positions come in units of so
    many `metres`.
    """

    cells: Tensor
    waves: Tensor

    def __init__(self, extent: float, octaves: int, metres: float = 1.0):
        super().__init__()
        self.width = 6 * octaves
        extent = extent / metres
        middle = (torch.arange(GRID) + 0.5) / GRID * extent
        axial, lateral = torch.meshgrid(middle, middle - extent / 2, indexing="ij")
        self.register_buffer("cells", torch.stack([lateral, axial]), persistent=False)
        waves = 2.0 * math.pi * metres / LONGEST * 2.0 ** torch.arange(octaves)
        self.register_buffer("waves", waves, persistent=False)

    def forward(self, parameters: Tensor, centre: Tensor) -> Tensor:
        """Return (B, width, 32, 32) features of (B, 12) parameters, relative to a (3,) centre."""
        pose = parameters_to_pose(parameters)
        lateral, axial = self.cells
        offset = (pose.position - centre)[..., None, None]
        right, beam = pose.rotation[..., 0, None, None], pose.rotation[..., 2, None, None]
        place = offset + right * lateral + beam * axial
        phase = (place.unsqueeze(1) * self.waves.view(-1, 1, 1, 1)).flatten(1, 2)
        return torch.cat([phase.sin(), phase.cos()], 1)


class Block(nn.Module):
    """Two convolutions around a skip; pose and time scale and shift in between (FiLM).

    Source: Perez et al., FiLM: Visual Reasoning with a General Conditioning Layer, 2018.
    """

    def __init__(self, width: int, embedding: int):
        super().__init__()
        self.conv_in = nn.Conv2d(width, width, 3, padding=1)
        self.norm = nn.GroupNorm(8, width)
        self.film = nn.Linear(embedding, 2 * width)
        self.conv_out = nn.Conv2d(width, width, 3, padding=1)
        _silence(self.film)
        _silence(self.conv_out)

    def forward(self, x: Tensor, embedding: Tensor) -> Tensor:
        """Return (B, width, H, W) of (B, width, H, W) and a (B, embedding) condition."""
        scale, shift = self.film(embedding)[..., None, None].chunk(2, 1)
        h = torch.addcmul(shift, self.norm(self.conv_in(x)), 1.0 + scale)
        return x + self.conv_out(relu(h))


def _silence(layer: nn.Module) -> None:
    """Start a layer at zero, so that a block begins as its skip."""
    for weight in layer.parameters():
        nn.init.zeros_(weight)


class PlacedUNet(nn.Module):
    """Image, time and pose to image, folded: 32×32, 16×16 and 8×8 cells."""

    centre: Tensor

    def __init__(
        self,
        width: int,
        octaves: int,
        extent: float,
        conditioning: Conditioning,
        precondition: bool,
        metres: float = 1.0,
    ):
        super().__init__()
        self.preconditioned = precondition
        self.register_buffer("centre", torch.zeros(3))
        self.conditioning, self.place = conditioning, Place(extent, octaves, metres)
        low, mid, high, embedding = width, 2 * width, 4 * width, 2 * width
        self.time = nn.Linear(8, embedding)
        self.pose = nn.Sequential(
            nn.Linear(conditioning.width, embedding), nn.SiLU(), nn.Linear(embedding, embedding)
        )
        self.enter = nn.Conv2d(CELL * CELL + self.place.width, low, 1)
        self.down_low = Block(low, embedding)
        self.to_mid = nn.Conv2d(low, mid, 2, stride=2)
        self.down_mid = Block(mid, embedding)
        self.to_high = nn.Conv2d(mid, high, 2, stride=2)
        self.middle = nn.ModuleList(Block(high, embedding) for _ in range(2))
        self.from_high = nn.ConvTranspose2d(high, mid, 2, stride=2)
        self.up_mid = Block(mid, embedding)
        self.from_mid = nn.ConvTranspose2d(mid, low, 2, stride=2)
        self.up_low = Block(low, embedding)
        self.leave = nn.Conv2d(low, CELL * CELL, 3, padding=1)
        _silence(self.leave)

    def forward(self, noisy: Tensor, time: Tensor, parameters: Tensor) -> Tensor:
        """Return the (B, 16, 32, 32) clean image foreseen from a noisy one of (B, 12) parameters.

        Both are folded; `time`, (B,) in [0, 1], is 0 for noise and 1 for the image.
        """
        waves = time[:, None] * math.pi * 2.0 ** torch.arange(4, device=time.device)
        condition = self.pose(self.conditioning(parameters))
        embedding = silu(condition + self.time(torch.cat([waves.sin(), waves.cos()], -1)))
        if not self.preconditioned:
            return self._foresee(noisy, embedding, parameters)
        keep, change, deviation = (scale[:, None, None, None] for scale in scales(time))
        return keep * noisy + change * self._foresee(noisy / deviation, embedding, parameters)

    def _foresee(self, noisy: Tensor, embedding: Tensor, parameters: Tensor) -> Tensor:
        place = self.place(parameters, self.centre)
        low = self.down_low(self.enter(torch.cat([noisy, place], 1)), embedding)
        mid = self.down_mid(self.to_mid(low), embedding)
        high = self.to_high(mid)
        for block in self.middle:
            high = block(high, embedding)
        mid = self.up_mid(self.from_high(high) + mid, embedding)
        low = self.up_low(self.from_mid(mid) + low, embedding)
        return self.leave(relu(low))

    def fit(self, parameters: Tensor) -> None:
        """Take what stays fixed in training from (N, 12) training parameters."""
        self.conditioning.fit(parameters)
        self.centre.copy_(parameters[:, POSITION].double().mean(0))
