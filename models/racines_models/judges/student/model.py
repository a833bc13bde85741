"""The grader's student: a small CNN that answers as its teacher does, many times as fast.

For environments with the grader in the loop. The images' 4 x 4 blocks become channels at once, so
nothing is computed at a high resolution; for inference, batch norm is folded into the convolutions.
"""

import copy
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from racines_data.errors import RacinesError
from racines_data.views import LABELS
from racines_models.judges.grader.model import Grader, Reading
from racines_models.networks.grading import GRADE_SCALE, GradingNetwork
from racines_models.training.augmentation import Augmentation

BLOCK = 4
"""Side of the blocks of pixels that become channels."""
POOLED = 2
"""Rows and columns of the encoder's pooled output: where in the image something stands counts."""


@dataclass(frozen=True)
class StudentConfig(Augmentation):
    """The student and its distillation, with the augmentation of the frames both look at."""

    input_size: int = 64
    """Images are averaged down to this height and width: 32, 64 or 128, at most the teacher's."""
    width: float = 1.0
    """Channels as a multiple of 32, 128 and 256."""
    batch_size: int = 256
    epochs: int = 8
    """Passes over the train frames, each time in another variant."""
    variants: int = 2
    """Variants of each frame that the teacher labels once: the frame itself, then augmented."""
    learning_rate: float = 3e-3
    """Peak of the one-cycle rate of AdamW."""
    weight_decay: float = 0.01
    temperature: float = 2.0
    """Divides the logits of both before they are compared (Hinton et al., 2015)."""
    grade_weight: float = 0.5
    """Weight of the smooth L1 loss on the teacher's grade."""
    bf16: bool = True
    """Grade in bfloat16; train in bfloat16 autocast where the processor has units for it."""
    ema: float = 0.0
    """Decay of the averaged weights that are kept; 0, none, as the rate ends at zero anyway."""
    checkpoint_seconds: float = 30.0
    """Least time between two checkpoints."""

    def __post_init__(self) -> None:
        """Refuse what cannot be trained."""
        if self.input_size not in (32, 64, 128):
            raise RacinesError(f"student.input_size {self.input_size}: choose 32, 64 or 128")
        if min(self.epochs, self.variants) < 1 or self.batch_size < 2:
            raise RacinesError("student: epochs and variants are 1 or more, batch_size 2 or more")
        if self.temperature <= 0.0:
            raise RacinesError(f"student.temperature {self.temperature}: give a positive number")


class Block(nn.Module):
    """Convolution, batch norm, ReLU; added to its input where the shapes allow."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        self.norm: nn.Module = nn.BatchNorm2d(outputs)
        self.residual = inputs == outputs and stride == 1

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, C, H, W) to (B, outputs, H / stride, W / stride)."""
        y = nn.functional.relu(self.norm(self.conv(x)), inplace=True)
        return x + y if self.residual else y


class StudentNetwork(GradingNetwork):
    """Five blocks under the grader's two heads."""

    def __init__(self, input_size: int, width: float = 1.0, labels: int = len(LABELS)) -> None:
        low, middle, high = (max(round(width * c), 1) for c in (32, 128, 256))
        encoder = nn.Sequential(
            nn.PixelUnshuffle(BLOCK),
            Block(BLOCK * BLOCK, low),
            Block(low, low),
            Block(low, middle, stride=2),
            Block(middle, middle),
            Block(middle, high, stride=2),
            nn.AdaptiveAvgPool2d(POOLED),
            nn.Flatten(),
        )
        super().__init__(encoder, input_size, high * POOLED * POOLED, labels)

    def folded(self, dtype: torch.dtype) -> nn.Module:
        """Return a copy of the encoder for inference: no batch norm, weights in `dtype`."""
        encoder = copy.deepcopy(self.encoder).eval()
        for block in encoder.modules():
            if isinstance(block, Block) and isinstance(block.norm, nn.BatchNorm2d):
                block.conv = fuse_conv_bn_eval(block.conv, block.norm)
                block.norm = nn.Identity()
        return encoder.to(dtype=dtype, memory_format=torch.channels_last)  # type: ignore[call-overload]


class Student(Grader):
    """A grader whose network is small; asked as a `Grader` is."""

    architecture: ClassVar[str] = "student"
    Config: ClassVar[type] = StudentConfig

    def __init__(self, network: GradingNetwork, *given: Any, **named: Any) -> None:
        """Take what a `Grader` does."""
        super().__init__(network, *given, **named)
        assert isinstance(network, StudentNetwork)
        self._dtype = torch.bfloat16 if self.config.bf16 else torch.float32
        self._encoder = network.folded(self._dtype).requires_grad_(False)

    @classmethod
    def build(cls, config: Any, labels: int) -> GradingNetwork:
        """Return an untrained network."""
        return StudentNetwork(config.input_size, config.width, labels)

    def answer(self, x: Tensor) -> Reading:
        """Return logits, grades and features of normalised (B, 1, S, S) images."""
        features = self._encoder(x.to(self._dtype)).float()
        logits, grades = self.network.heads(features)
        return Reading(logits, grades.clamp(0.0, GRADE_SCALE), features)
