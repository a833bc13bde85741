"""Networks that tell a view and a grade: an encoder and two heads, on images they normalise."""

from typing import Any

import torch
from torch import Tensor, nn

from racines_data.imaging import IMAGE_SIZE
from racines_data.views import LABELS

FEATURES = 512
"""Width of the ResNet's output at width 1."""
GRADE_SCALE = 10.0
"""Grades lie in 0-10."""


class GradingNetwork(nn.Module):
    """An encoder and heads; owns the normalisation of (B, 128, 128) uint8 images."""

    def __init__(self, encoder: nn.Module, input_size: int, features: int, labels: int) -> None:
        super().__init__()
        self.factor = IMAGE_SIZE // input_size
        self.features = features
        self.encoder = encoder
        self.view_head = nn.Linear(features, labels)
        self.grade_head = nn.Sequential(
            nn.Linear(features, 128), nn.ReLU(inplace=True), nn.Linear(128, 1)
        )
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def normalise(self, images: Tensor) -> Tensor:
        """Turn (B, 128, 128) gray levels, any type, into (B, 1, S, S) in [-1, 1]."""
        step = self.factor
        # Adding strided slices is several times as quick as pooling an image of one channel.
        total = images[:, ::step, ::step].to(torch.float32, copy=True)
        for place in range(1, step * step):
            total += images[:, place // step :: step, place % step :: step]
        x = total.mul_(1.0 / (step * step * 127.5)).sub_(1.0)
        return x.unsqueeze(1).contiguous(memory_format=torch.channels_last)

    def heads(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Return (B, labels) view logits and (B,) unclamped grades of (B, D) features."""
        grade = self.grade_head(features).squeeze(-1)
        return self.view_head(features), GRADE_SCALE * grade.float()

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Return (B, labels) view logits and (B,) grades of normalised images."""
        return self.heads(self.encoder(x))


class GraderNetwork(GradingNetwork):
    """MONAI's ResNet-18 of one channel under the two heads."""

    def __init__(self, input_size: int, width: float = 1.0, labels: int = len(LABELS)) -> None:
        from monai.networks.nets.resnet import resnet18

        shape: dict[str, Any] = {"spatial_dims": 2, "n_input_channels": 1, "conv1_t_stride": 2}
        encoder = resnet18(**shape, feed_forward=False, widen_factor=width)
        super().__init__(encoder, input_size, int(FEATURES * width), labels)
