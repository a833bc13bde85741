"""The network of `pair-cnn`: frames of a short window as channels, six numbers out.

Of the kind of Prevost et al., 3D freehand ultrasound without external tracking using deep learning
(Medical Image Analysis, 2018), and of the baseline of TUS-REC, at a size for one CPU core.
"""

from dataclasses import dataclass, field

import torch
from torch import Tensor, nn

from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE
from racines_models.training.augmentation import Augmentation
from racines_models.training.objective import Training

NUMBERS = 6
"""Shift, m, and rotation vector, rad."""


@dataclass(frozen=True)
class PairTraining(Training):
    """The trainer's settings (see `Training`) with the defaults of this task."""

    images: int = 80_000
    batch_size: int = 64
    schedule: str = "cosine"
    warmup_images: int = 6_400
    gradient_clip: float = 1.0
    log_every: int = 6_400
    sample_every: int = 16_000
    checkpoint_every: int = 16_000


@dataclass(frozen=True)
class PairConfig:
    """The network and its training."""

    input_size: int = 64
    """Images are averaged down to this height and width: 64 or 128."""
    window: int = 2
    """Frames that are looked at, the last of which is the one that moved; 2 or more."""
    widths: tuple[int, ...] = (16, 24, 48, 80, 128)
    """Channels, each at half the side of those before."""
    hidden: int = 192
    """Width of the dense layer behind the flattened last map."""
    learning_rate: float = 2e-3
    """Peak of AdamW's rate."""
    weight_decay: float = 0.05
    reverse: float = 0.25
    """Share of the training pairs that are shown last frame first, with the motion undone."""
    reach: float = 0.15
    """Side, m, of the square under the probe on whose nine points the loss is measured."""
    augmentation: Augmentation = field(default_factory=lambda: Augmentation(erase=0.0, noise=0.0))
    training: PairTraining = field(default_factory=PairTraining)

    def __post_init__(self) -> None:
        """Refuse sizes that the network cannot take."""
        if self.input_size not in (64, 128):
            raise RacinesError(f"pair-cnn.input_size {self.input_size}: choose 64 or 128")
        if self.window < 2:
            raise RacinesError(f"pair-cnn.window {self.window}: give 2 or more frames")
        if not self.widths or min(self.widths) < 1 or self.input_size >> len(self.widths) < 1:
            raise RacinesError(f"pair-cnn.widths {list(self.widths)}: give one to six numbers")
        if not 0.0 <= self.reverse <= 1.0:
            raise RacinesError(f"pair-cnn.reverse {self.reverse:g}: give 0 to 1")


class PairNetwork(nn.Module):
    """Strided residual blocks over stacked frames; owns the normalisation of images and motions."""

    mean: Tensor
    std: Tensor

    def __init__(self, config: PairConfig) -> None:
        super().__init__()
        self.factor = IMAGE_SIZE // config.input_size
        channels = (config.window + 1, *config.widths)  # and what differs between the last two
        blocks = [_Block(*pair) for pair in zip(channels, channels[1:], strict=False)]
        side = config.input_size >> len(config.widths)
        features = config.widths[-1] * side * side
        self.body = nn.Sequential(*blocks, nn.Flatten())
        self.head = nn.Sequential(
            nn.Linear(features, config.hidden), nn.ReLU(), nn.Linear(config.hidden, NUMBERS)
        )
        self.register_buffer("mean", torch.zeros(NUMBERS))
        self.register_buffer("std", torch.ones(NUMBERS))
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def fit_motions(self, motions: Tensor) -> None:
        """Take mean and deviation of (N, 6) training motions."""
        self.mean.copy_(motions.mean(0))
        self.std.copy_(motions.std(0, correction=0).clamp_min(1e-6))

    def normalise(self, windows: Tensor) -> Tensor:
        """Turn (B, W, 128, 128) gray levels into (B, W, S, S) in [-1, 1]."""
        x = windows.to(torch.float32) / 127.5 - 1.0
        return nn.functional.avg_pool2d(x, self.factor) if self.factor > 1 else x

    def forward(self, x: Tensor) -> Tensor:
        """Return the (B, 6) motions, m and rad, of normalised windows."""
        x = torch.cat([x, x[:, -1:] - x[:, -2:-1]], 1)
        maps = self.body(x.contiguous(memory_format=torch.channels_last))
        return self.head(maps).float() * self.std + self.mean


class _Block(nn.Module):
    """Two convolutions, the first of which halves the side, beside a shortcut."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(inputs, outputs, 3, 2, 1, bias=False)
        self.first_norm = nn.BatchNorm2d(outputs)
        self.second = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        self.second_norm = nn.BatchNorm2d(outputs)
        self.shortcut = nn.Conv2d(inputs, outputs, 2, 2, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        inner = torch.relu(self.first_norm(self.first(x)))
        return torch.relu(self.second_norm(self.second(inner)) + self.shortcut(x))


def windows(rows: Tensor, window: int, first: Tensor | int) -> Tensor:
    """Return the (N, W) rows up to and with (N,) rows; none before (N,) first rows of the sweep."""
    back = torch.arange(window - 1, -1, -1)
    floor = torch.as_tensor(first).expand(len(rows)).unsqueeze(1)
    return torch.maximum(rows.unsqueeze(1) - back, floor)
