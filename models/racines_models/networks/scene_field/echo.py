"""From a field sampled along the beams to gray levels: a small model of how echoes add up.

Amplitudes of the fine field are weighted by what reaches them, added up coherently over the
neighbouring beams and samples, squared, and joined by what adds up incoherently; then follow
logarithm, gray map and smoothing. Every number in it is learned; those that start from a
physical guess are named in `EchoDecoder`. `image_loss` is what a drawn image costs.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from racines_data.geometry import Pose
from racines_models.networks.layers import on_circle

MID = 9
"""Channels of the coarse field: attenuation, incoherent power, coherent gain, two vectors."""
REACH, SMOOTH = 6, 3
"""Half-widths of the beam profiles and of the smoothing, beams."""
WINDOW, SIGMA = 11, 1.5
"""The window of Wang et al. (2004), as in the score of structural similarity."""


class Place(nn.Module):
    """Describes a pose for the contact: position at three zooms and the rotation, (B, 21).

    A `phased` one describes the phase of the beat besides, (B, 23).
    """

    middle: Tensor
    spread: Tensor
    mean: Tensor
    std: Tensor

    def __init__(self, phased: bool = False) -> None:
        super().__init__()
        self.width = 21 + 2 * phased
        for name, size in (("middle", 3), ("spread", 3), ("mean", 12), ("std", 12)):
            self.register_buffer(name, torch.zeros(size))

    def fit(self, pose: Pose) -> None:
        """Take the scales of the training poses: quartiles, and mean and deviation."""
        quartiles = pose.position.double().quantile(torch.tensor([0.25, 0.5, 0.75]).double(), 0)
        raw = self._raw(pose).double()
        self.middle.copy_(quartiles[1])
        self.spread.copy_((quartiles[2] - quartiles[0]).clamp_min(1e-4))
        self.mean.copy_(raw.mean(0))
        self.std.copy_(raw.std(0, correction=0).clamp_min(1e-4))

    def _raw(self, pose: Pose) -> Tensor:
        return torch.cat([pose.position, pose.rotation.flatten(1)], 1)

    def forward(self, pose: Pose, beat: Tensor | None = None) -> Tensor:
        """Return the (B, 21) description; (B, 23) with (B, 1) phases of the beat."""
        near = ((pose.position - self.middle) / self.spread).clamp(-4.0, 4.0)
        zooms = [near, near.tanh(), (0.3 * near).tanh()]
        phase = [] if beat is None else [on_circle(beat)]
        return torch.cat([(self._raw(pose) - self.mean) / self.std, *zooms, *phase], 1)


class EchoDecoder(nn.Module):
    """Turns (B, L, S, C) fine and (B, L/2, S/2, 9) coarse numbers into (B, L, S) gray, 0-1.

    L are the beams, S the samples along one; `inputs` entries describe a pose for the contact.
    """

    def __init__(self, beams: int, samples: int, inputs: int, hidden: int = 64):
        # A beam as wide as its neighbours' distance, and a 68 dB gray scale, to start from.
        super().__init__()
        self.far = nn.Parameter(_bell(0.85, REACH))
        self.near = nn.Parameter(_bell(1.85, REACH))
        self.nearness = nn.Parameter(torch.linspace(2.0, -4.0, samples))
        self.sides = nn.Parameter(torch.tensor([0.2, -0.2]))
        self.gain = nn.Parameter(torch.zeros(beams, samples))
        self.floor = nn.Parameter(torch.full((beams, samples), -5.0))
        self.dark = nn.Parameter(torch.full((beams, samples), -5.0))
        self.shade = nn.Parameter(torch.tensor([0.147, 0.75]))
        self.gray = nn.Parameter(torch.tensor([0.6, 0.3]))
        beams_bell, samples_bell = _bell(0.8, SMOOTH), _bell(0.3, SMOOTH)
        self.smooth_beams = nn.Parameter(beams_bell / beams_bell.sum())
        self.smooth_samples = nn.Parameter(samples_bell / samples_bell.sum())
        last = nn.Linear(hidden, beams)
        nn.init.zeros_(last.weight)
        nn.init.constant_(last.bias, 3.0)
        self.contact = nn.Sequential(
            nn.Linear(inputs, hidden), nn.SiLU(), nn.Linear(hidden, hidden), nn.SiLU(), last
        )

    def forward(self, fine: Tensor, coarse: Tensor, directions: Tensor, pose: Tensor) -> Tensor:
        """Return the gray levels, by (B, L, 3) directions of the beams and (B, inputs) of poses."""
        loss, power, amplitude, mirror = self._tissue(coarse, directions)
        coupling = self.contact(pose).sigmoid().unsqueeze(-1)
        received = (self.gain - loss.cumsum(-1)).exp() * coupling
        incoherent = (power.exp() + 10.0 * mirror.square()) * received.square()
        incoherent = incoherent + self.floor.exp() + self.dark.exp() * (1.0 - coupling)
        amplitude = fine * (received * amplitude.exp()).unsqueeze(-1)
        echoes = self._coherent(amplitude.permute(0, 3, 1, 2))
        level = (echoes + incoherent.unsqueeze(1)).log().mean(1)
        shade = level * self.shade[0] + self.shade[1]
        shade = functional.elu(8.0 * shade) * 0.125 + 0.125  # smooth where a gray map clips
        gray = shade.square() * (self.gray[0] + self.gray[1] * shade)
        gray = torch.matmul(_banded(self.smooth_beams, gray.shape[1]), gray)
        return torch.matmul(gray, _banded(self.smooth_samples, gray.shape[2]))

    def _tissue(self, coarse: Tensor, directions: Tensor) -> tuple[Tensor, ...]:
        """Return (B, L, S) loss, log power, log amplitude and mirror echo, seen from a side."""
        along = directions[:, ::2].unsqueeze(2)
        sheet = (coarse[..., 3:6] * along).sum(-1).abs()
        mirror = (coarse[..., 6:9] * along).sum(-1)
        loss = functional.softplus(4.0 * coarse[..., 0] - 3.0) * 0.05 + 0.02 * mirror.abs()
        power = 4.0 * coarse[..., 1] - 2.0 + 3.0 * sheet
        amplitude = 2.0 * coarse[..., 2] + sheet
        parts = torch.stack([loss, power, amplitude, mirror], 1)
        size = tuple(self.gain.shape)
        full = functional.interpolate(parts, size, mode="bilinear", align_corners=False)
        return full.unbind(1)

    def _coherent(self, amplitude: Tensor) -> Tensor:
        """Return the (B, 2, L, S) power of (B, C, L, S) amplitudes heard in two sub-bands."""
        count, channels, beams, samples = amplitude.shape
        sides = functional.pad(amplitude[..., 1:], (0, 1))
        sides = sides + functional.pad(amplitude[..., :-1], (1, 0))
        bands = torch.cat([amplitude + side * sides for side in self.sides], 1)
        share = self.nearness.sigmoid()
        bands = torch.cat([bands * (1.0 - share), bands * share], 2)
        profiles = torch.cat([_banded(self.far, beams), _banded(self.near, beams)], 1)
        heard = torch.matmul(profiles, bands).square()
        return heard.view(count, 2, channels, beams, samples).sum(2)


def _bell(sigma: float, reach: int) -> Tensor:
    taps = torch.exp(-0.5 * (torch.arange(-reach, reach + 1.0) / sigma) ** 2)
    return taps / taps.norm()


def _banded(taps: Tensor, size: int) -> Tensor:
    """Return the (size, size) matrix that convolves with (2 r + 1,) taps."""
    reach = len(taps) // 2
    index = torch.arange(size, device=taps.device)
    offset = index.unsqueeze(0) - index.unsqueeze(1) + reach
    picked = taps[offset.clamp(0, 2 * reach)]
    return picked * ((offset >= 0) & (offset <= 2 * reach))


def image_loss(drawn: Tensor, truth: Tensor) -> tuple[Tensor, Tensor]:
    """Return the mean SSIM and a smooth absolute error of (B, H, W) images, black 0 and white 1."""
    error = ((drawn - truth).square() + 1e-4).sqrt().mean()
    return similarity(drawn, truth), error


def similarity(drawn: Tensor, truth: Tensor) -> Tensor:
    """Return the mean SSIM where the window is whole; the blur is two matrix products."""
    half = WINDOW // 2
    taps = torch.exp(-0.5 * ((torch.arange(WINDOW) - half) / SIGMA) ** 2)
    taps = (taps / taps.sum()).to(drawn)
    rows, columns = (_banded(taps, size)[half:-half] for size in drawn.shape[1:])
    maps = torch.stack([drawn, truth, drawn * drawn, truth * truth, drawn * truth])
    a, b, aa, bb, ab = rows @ maps @ columns.T
    spread, shared = aa - a * a + bb - b * b, ab - a * b
    value = (2.0 * a * b + 1e-4) * (2.0 * shared + 9e-4)
    return (value / ((a * a + b * b + 1e-4) * (spread + 9e-4))).mean()
