"""Networks of the agents: one shape for actor and critic, another last layer."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from racines_data.errors import RacinesError
from racines_data.geometry import matrix_from_6d, matrix_to_euler
from racines_envs.task.core import PARAMS_SIZE

KEYS = {"image": ["image"], "params": ["params"], "multimodal": ["image", "params"]}
"""What a network of each observation reads, in order."""

ROTATIONS = {"continuous": PARAMS_SIZE, "euler": 6}
"""Numbers of a pose by how its rotation is read."""


def keys_of(observation: str, encoded: bool) -> list[str]:
    """Return what a network reads, in order; of an encoded image it reads the features."""
    return ["features" if encoded and key == "image" else key for key in KEYS[observation]]


class ObservationNetwork(nn.Module):
    """Convolutions with batch norm for the image, dense layers for numbers, then a head.

    It owns its normalisation: images are 0-255 (…, 1, 128, 128); parameters and features are
    standardised by running statistics, since the probe's height varies by a tenth of what the
    workspace allows.
    """

    def __init__(
        self,
        observation: str,
        outputs: int,
        hidden: Sequence[int],
        gain: float,
        features: int = 0,
        rotation: str = "continuous",
    ) -> None:
        """Build for an observation; `gain` scales the first outputs (small: near uniform).

        Args:
            observation: `image`, `params` or `multimodal`.
            outputs: Width of the head.
            hidden: Widths of the dense layers.
            gain: Of the head's first weights.
            features: Numbers that an encoder makes of an image, read in its place; 0 without one.
            rotation: `continuous`: the parameters as they are; `euler`: position and angles.

        Raises:
            RacinesError: another rotation.
        """
        super().__init__()
        if rotation not in ROTATIONS:
            raise RacinesError(f"rotation is {rotation!r}: {' or '.join(ROTATIONS)}")
        self.rotation = rotation
        self.keys = keys_of(observation, features > 0)
        self.image = _convolutions(hidden[0]) if "image" in self.keys else None
        self.params = self.scale = self.features = self.feature_scale = None
        if "features" in self.keys:
            self.feature_scale = nn.BatchNorm1d(features, affine=False, momentum=None)
            self.features = _dense([features, hidden[0]])
        if "params" in self.keys:
            self.scale = nn.BatchNorm1d(ROTATIONS[rotation], affine=False, momentum=None)
            self.params = _dense([ROTATIONS[rotation], hidden[0]])
        self.body = _dense([hidden[0] * len(self.keys), *hidden[1:]])
        self.head = nn.Linear(hidden[-1], outputs)
        for module in self.modules():
            if isinstance(module, (nn.Linear, nn.Conv2d)):
                nn.init.orthogonal_(module.weight, gain if module is self.head else 2.0**0.5)
                if module.bias is not None:
                    nn.init.zeros_(module.bias)

    def forward(self, *seen: Tensor) -> Tensor:
        """Map observations in the order of `keys`, any leading shape, to (…, outputs)."""
        values = dict(zip(self.keys, seen, strict=True))
        features = []
        if self.features is not None and self.feature_scale is not None:
            features.append(self.features(_scaled(self.feature_scale, values["features"])))
        if self.image is not None:
            image = values["image"]
            flat = image.reshape(-1, *image.shape[-3:]).float() / 127.5 - 1.0
            features.append(self.image(flat).view(*image.shape[:-3], -1))
        if self.params is not None and self.scale is not None:
            params = values["params"]
            params = _with_angles(params) if self.rotation == "euler" else params
            features.append(self.params(_scaled(self.scale, params)))
        return self.head(self.body(torch.cat(features, -1)))


def _with_angles(params: Tensor) -> Tensor:
    """Turn (…, 9) position and rotation's columns into (…, 6) position and Euler angles, rad."""
    return torch.cat([params[..., :3], matrix_to_euler(matrix_from_6d(params[..., 3:]))], -1)


def _scaled(scale: nn.Module, values: Tensor) -> Tensor:
    return scale(values.reshape(-1, values.shape[-1])).view(values.shape)


def _convolutions(features: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for inputs, outputs, stride in ((1, 16, 4), (16, 32, 2), (32, 32, 2), (32, 32, 2)):
        layers += [
            nn.Conv2d(inputs, outputs, 2 * stride - 1, stride, stride - 1),
            nn.BatchNorm2d(outputs),
            nn.ReLU(),
        ]
    return nn.Sequential(*layers, nn.Flatten(), nn.Linear(32 * 4 * 4, features), nn.Tanh())


def _dense(sizes: Sequence[int]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for inputs, outputs in zip(sizes, sizes[1:], strict=False):
        layers += [nn.Linear(inputs, outputs), nn.Tanh()]
    return nn.Sequential(*layers)
