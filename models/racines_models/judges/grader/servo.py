"""A grader that begins as a servo: an encoder that read the ways to all views tells which it sees.

Transfer of features (Yosinski et al., How Transferable Are Features in Deep Neural Networks?,
2014): a servo's network has looked at millions of simulated frames, and where the probe stands is
what a grade hangs on. The heads are new; encoder and heads go on by the grader's two stages.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_models.judges.grader.model import Grader, GraderConfig
from racines_models.networks.grading import GradingNetwork
from racines_models.networks.servo import SAID, ServoNetwork
from racines_models.published.places import published
from racines_models.weights import load_weights

POLICY = "policy.safetensors"
LAST = "head.2."
"""Begins the names of the layer that says the ways, which a grader has no use for."""


@dataclass(frozen=True)
class ServoGraderConfig(GraderConfig):
    """A grader through a servo's eyes; its shape is the servo's."""

    input_size: int = 128
    """Height and width that the servo looks at."""
    servo: str = "envs/weights/servo-full"
    """Folder of the servo that the encoder begins as, by its first training. What that learned
    from has to be train patients."""
    widths: tuple[int, ...] = (24, 40, 64, 96, 144, 192)
    """The servo's channels, the last at 2 pixels a side."""
    blocks: tuple[int, ...] = (2, 2, 2, 1, 1)
    """The servo's blocks of each width after the first."""

    def __post_init__(self) -> None:
        """Refuse a size that such widths do not look at, and a width of ResNet-18's."""
        super().__post_init__()
        if self.input_size != 2 ** (len(self.widths) + 1):
            raise RacinesError(
                f"grader.widths: {len(self.widths)} of them look at images of "
                f"{2 ** (len(self.widths) + 1)} pixels, and grader.input_size is {self.input_size}"
            )
        if self.width != 1.0:
            raise RacinesError("grader.width: is ResNet-18's; a servo's channels are grader.widths")


class _Sight(nn.Module):
    """A servo's network up to the features from which it would say the ways."""

    def __init__(self, servo: ServoNetwork) -> None:
        super().__init__()
        self.body, self.dense = servo.body, servo.head[:-1]

    def forward(self, x: Tensor) -> Tensor:
        """Return (B, 320) features of (B, 1, S, S) images in [-1, 1]; a servo's are in 0-1."""
        gray = (0.5 * (x + 1.0)).contiguous(memory_format=torch.channels_last)
        return self.dense(self.body(gray))


class ServoGraderNetwork(GradingNetwork):
    """A servo's network under the grader's two heads."""

    def __init__(self, config: ServoGraderConfig, labels: int) -> None:
        servo = ServoNetwork(1, config.widths, config.blocks)
        features: Any = servo.head[0]
        super().__init__(_Sight(servo), config.input_size, features.out_features, labels)


class ServoGrader(Grader):
    """Labels and grades images through a servo's eyes."""

    architecture: ClassVar[str] = "servo"
    Config: ClassVar[type] = ServoGraderConfig

    @classmethod
    def build(cls, config: Any, labels: int) -> GradingNetwork:
        """Return an untrained network."""
        return ServoGraderNetwork(config, labels)

    @classmethod
    def begin(cls, network: GradingNetwork, config: Any) -> dict[str, Any]:
        """Give the encoder the servo's weights; return, as `began_as`, folder and sha256 of them.

        Raises:
            RacinesError: no such servo, or one of other widths or blocks.
        """
        path = published(Path(config.servo)) / POLICY
        tensors = load_weights(path, remedy="name a trained servo's folder as grader.servo")
        views = len(tensors.get(f"{LAST}bias", ())) // SAID
        servo = ServoNetwork(max(views, 1), config.widths, config.blocks)
        try:
            servo.load_state_dict(tensors)
        except RuntimeError as error:
            raise RacinesError(
                f"{path}: does not fit grader.widths {list(config.widths)} and grader.blocks "
                f"{list(config.blocks)}: give those of its config.json"
            ) from error
        network.encoder.load_state_dict(_Sight(servo).state_dict())
        return {"began_as": {"servo": config.servo, "sha256": sha256_file(path)}}
