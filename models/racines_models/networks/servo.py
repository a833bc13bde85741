"""The servo's network: what one image shows of every view.

That is the way to it, how sure that is, and how good the image is as this view.
"""

from collections.abc import Sequence
from typing import NamedTuple, cast

import torch
from torch import Tensor, nn

SIDE = 64
"""Pixels of the images that it looks at, along a side, with the widths that it has by default."""
WIDTHS = (24, 40, 72, 128, 160)
"""Channels at 32, 16, 8, 4 and 2 pixels a side."""
SCALE = (0.02, 0.02, 0.02, 0.35, 0.35, 0.35)
"""Metres and radians that count as one in what it says."""
SURENESS = (-4.0, 3.0)
"""Range of the logarithm of the deviations, in units of `SCALE`."""
SAID = 14
"""Numbers a view: six of the way, six of how sure it is, and the logits of score and grade."""


class Said(NamedTuple):
    """What the network says of B images."""

    ways: Tensor
    """(B, V, 6), in `SCALE`."""
    sureness: Tensor
    """(B, V, 6) logarithms of the deviations, in `SCALE`."""
    scores: Tensor
    """(B, V) logits of how completely the views are shown."""
    grades: Tensor
    """(B, V) logits of a tenth of their grades."""


class Reading(NamedTuple):
    """What B images show."""

    ways: Tensor
    """(B, V, 6) to the views, m and rad."""
    deviations: Tensor
    """(B, V, 6) of the ways, m and rad."""
    scores: Tensor
    """(B, V) expected completeness, 0-1."""
    grades: Tensor
    """(B, V) expected grades, 0-10."""


class ServoNetwork(nn.Module):
    """Residual convolutions down to 2×2, then two dense layers; it owns its normalisation."""

    def __init__(
        self, views: int, widths: Sequence[int] = WIDTHS, blocks: Sequence[int] = ()
    ) -> None:
        """Build for so many views.

        Args:
            views: how many.
            widths: channels, the last at 2 pixels a side, each before at twice as many: five look
                at images of 64 pixels, six at 128.
            blocks: of each width after the first; one of each if empty.
        """
        super().__init__()
        self.views, self.side = views, 2 ** (len(widths) + 1)
        first = nn.Conv2d(1, widths[0], 5, 2, 2, bias=False)
        layers = [first, nn.BatchNorm2d(widths[0]), nn.ReLU()]
        for before, after, count in zip(
            widths, widths[1:], blocks or [1] * (len(widths) - 1), strict=False
        ):
            layers += [_Block(before, after), *(_Block(after, after, 1) for _ in range(count - 1))]
        self.body = nn.Sequential(*layers, nn.Flatten())
        self.head = nn.Sequential(
            nn.Linear(widths[-1] * 4, 320), nn.ReLU(), nn.Linear(320, views * SAID)
        )
        self.register_buffer("scale", torch.tensor(SCALE), persistent=False)
        # With the channels last a CPU learns from a fifth more images a second.
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, images: Tensor) -> Said:
        """Look at (B, 1, side, side) images, black 0 and white 1."""
        return self.say(self.features(images))

    def features(self, images: Tensor) -> Tensor:
        """Return (B, 320) of images, from which everything is said."""
        maps = self.body(images.contiguous(memory_format=torch.channels_last))
        return self.head[:-1](maps)

    def say(self, features: Tensor) -> Said:
        """Return what is said of (B, 320) features."""
        said = self.head[-1](features).view(len(features), self.views, SAID)
        return Said(said[..., :6], said[..., 6:12].clamp(*SURENESS), *said[..., 12:].unbind(-1))

    def read(self, images: Tensor) -> Reading:
        """Read (B, side, side) gray levels."""
        ways, sureness, *shown = self(images.unsqueeze(1).float() / 255.0)
        scores, grades = (each.sigmoid() for each in shown)
        return Reading(ways * self.scale, sureness.exp() * self.scale, scores, 10.0 * grades)


class ServoEnsemble(nn.Module):
    """Several servo networks, of which each counts, axis by axis, by how sure it is.

    Where they disagree the deviation is that of their mixture (Lakshminarayanan, Pritzel, Blundell,
    Simple and Scalable Predictive Uncertainty Estimation using Deep Ensembles, NeurIPS 2017).
    """

    def __init__(self, members: Sequence[nn.Module]) -> None:
        """Take networks of the same views."""
        super().__init__()
        self.members = nn.ModuleList(members)

    @property
    def side(self) -> int:
        """Return the pixels of its images along a side."""
        return cast(ServoNetwork, self.members[0]).side

    def read(self, images: Tensor) -> Reading:
        """Read (B, side, side) gray levels."""
        each = [cast(ServoNetwork, member).read(images) for member in self.members]
        ways, deviations, scores, grades = (torch.stack(part) for part in zip(*each, strict=True))
        counts = deviations.square().reciprocal()
        counts = counts / counts.sum(0)
        way = (counts * ways).sum(0)
        spread = (counts * (deviations.square() + (ways - way).square())).sum(0).sqrt()
        return Reading(way, spread, scores.mean(0), grades.mean(0))


class _Block(nn.Module):
    """Two convolutions beside a shortcut; the first of them has the stride."""

    def __init__(self, inputs: int, outputs: int, stride: int = 2) -> None:
        super().__init__()
        self.first = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        self.first_norm = nn.BatchNorm2d(outputs)
        self.second = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        self.second_norm = nn.BatchNorm2d(outputs)
        narrow = nn.Conv2d(inputs, outputs, 1, stride, bias=False)
        self.shortcut = nn.Identity() if stride == 1 else narrow

    def forward(self, x: Tensor) -> Tensor:
        inner = torch.relu(self.first_norm(self.first(x)))
        return torch.relu(self.second_norm(self.second(inner)) + self.shortcut(x))
