"""Networks of the agents: one shape for actor and critic, and the encoder that they look through.

The encoder is frozen and did not learn from reward. A policy of convolutions from scratch has to
find out from reward alone what an image shows, which takes millions of steps. A pose regressor has
learned where an image was taken; a policy that reads its answer has only the way left to learn. It
is given the image alone, in training and after.
"""

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor, nn

from racines_data.errors import RacinesError
from racines_data.geometry import matrix_from_6d, matrix_to_euler
from racines_envs.task.core import PARAMS_SIZE
from racines_models.published.places import WEIGHTS, published

SEEN = {"image": ["image"], "params": ["params"], "multimodal": ["image", "params"]}
"""What each observation holds, in the order in which networks read it."""

ROTATIONS = {"continuous": PARAMS_SIZE, "euler": 6}
"""Numbers of a pose by how its rotation is read."""

PUBLISHED = {"explored": WEIGHTS / "encoder", "pose": WEIGHTS / "pose"}
"""Encoders of the repository: what `racines train encoder` made of the profile `reference`, and the
pose regressor of the dataset's sweeps, which is lost where tasks start."""
BESIDE = "encoder"
"""Folder beside a policy that holds the encoder's own copy."""


class ObservationNetwork(nn.Module):
    """Convolutions with batch norm for the image, dense layers for numbers, then a head.

    It owns its normalisation: images are 0-255 (…, 1, 128, 128); parameters and features are
    standardised by running statistics, since the probe's height varies by a tenth of what the
    workspace allows.
    """

    def __init__(
        self, observation: str, outputs: int, hidden: Sequence[int], gain: float,
        features: int = 0, rotation: str = "continuous", looks: int = 0,
    ) -> None:  # fmt: skip
        """Build for an observation; `gain` scales the head's first weights (small: near uniform).

        `hidden` are widths of the dense layers, `features` the numbers that an encoder makes of an
        image, read in its place (0: there is none). `rotation` is `continuous`, the parameters as
        they are, or `euler`, position and angles; another is refused. Of several `looks` the
        features are read one look after the other, the oldest first, by a `Recurrence`.
        """
        super().__init__()
        if rotation not in ROTATIONS:
            raise RacinesError(f"rotation is {rotation!r}: {' or '.join(ROTATIONS)}")
        self.rotation = rotation
        self.looks = looks
        self.keys = ["features" if features and k == "image" else k for k in SEEN[observation]]
        self.image = _convolutions(hidden[0]) if "image" in self.keys else None
        self.params = self.scale = self.features = self.feature_scale = None
        if "features" in self.keys:
            features //= looks or 1
            self.feature_scale = nn.BatchNorm1d(features, affine=False, momentum=None)
            widths = features, hidden[0]
            self.features = Recurrence(*widths) if looks else _dense(widths)
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
            told = values["features"]
            if self.looks:
                told = told.view(*told.shape[:-1], self.looks, -1)
            features.append(self.features(_scaled(self.feature_scale, told)))
        if self.image is not None:
            image = values["image"]
            flat = image.reshape(-1, *image.shape[-3:]).float() / 127.5 - 1.0
            features.append(self.image(flat).view(*image.shape[:-3], -1))
        if self.params is not None and self.scale is not None:
            params = values["params"]
            if self.rotation == "euler":
                angles = matrix_to_euler(matrix_from_6d(params[..., 3:]))
                params = torch.cat([params[..., :3], angles], -1)
            features.append(self.params(_scaled(self.scale, params)))
        return self.head(self.body(torch.cat(features, -1)))


def _scaled(scale: nn.Module, values: Tensor) -> Tensor:
    return scale(values.reshape(-1, values.shape[-1])).view(values.shape)


class Recurrence(nn.Module):
    """Gated recurrent unit (Cho et al., 2014), written so that a row ignores its batch.

    `nn.GRU` multiplies whole batches, whose last rows round otherwise than the others.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.reads, self.keeps = nn.Linear(inputs, 3 * outputs), nn.Linear(outputs, 3 * outputs)

    def forward(self, looks: Tensor) -> Tensor:
        """Return the (…, outputs) state after (…, L, inputs) looks, from a state of zeros."""
        read = self.reads(looks).unbind(-2)
        state = read[0].new_zeros(*read[0].shape[:-1], read[0].shape[-1] // 3)
        for look in read:
            own, kept = look.chunk(3, -1), self.keeps(state).chunk(3, -1)
            # A logistic function by tanh rounds alike at every place of a tensor.
            reset, update = (
                0.5 + 0.5 * ((a + b) / 2).tanh() for a, b in zip(own[:2], kept[:2], strict=True)
            )
            new = (own[2] + reset * kept[2]).tanh()
            state = new + update * (state - new)
        return state


def _convolutions(features: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for inputs, outputs, stride in ((1, 16, 4), (16, 32, 2), (32, 32, 2), (32, 32, 2)):
        convolution = nn.Conv2d(inputs, outputs, 2 * stride - 1, stride, stride - 1)
        layers += [convolution, nn.BatchNorm2d(outputs), nn.ReLU()]
    return nn.Sequential(*layers, nn.Flatten(), nn.Linear(32 * 4 * 4, features), nn.Tanh())


def _dense(sizes: Sequence[int]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for inputs, outputs in zip(sizes, sizes[1:], strict=False):
        layers += [nn.Linear(inputs, outputs), nn.Tanh()]
    return nn.Sequential(*layers)


class PoseEncoder(nn.Module):
    """A pose regressor's standardised answer: position (3) and continuous rotation (6)."""

    size = 9

    def __init__(self, network: nn.Module, sha256: str | None) -> None:
        """Take the network of a `PoseRegressor` and the hash of its weights."""
        super().__init__()
        self.network, self.sha256 = network, sha256

    def forward(self, images: Tensor) -> Tensor:
        """Return (B, 9) float32 of (B, 128, 128) gray levels 0-255, any type."""
        return self.network(self.network.normalise(images))  # pyright: ignore[reportCallIssue]


def open_encoder(
    spec: str, device: str = "cpu", near: Path | None = None, sha256: str | None = None
) -> PoseEncoder | None:
    """Return the frozen encoder that a config names; None for "", a policy that learns to see.

    The spec is `explored` or `pose` (published, see `PUBLISHED`), a folder of another, or "". A
    copy in the folder `near`, of a policy, goes first. With a `sha256` the copy, the folder, then
    the published ones are searched for weights of that hash.

    Raises:
        RacinesError: no pose regressor there, or none of the hash.
    """
    if not spec:
        return None
    from racines_models.judges.pose.regressor import PoseRegressor

    named = published(PUBLISHED[spec]) if spec in PUBLISHED else Path(spec)
    places = [named] if near is None else [near / BESIDE, named]
    places += map(published, PUBLISHED.values()) if sha256 is not None else ()
    found = [folder for folder in places if folder.is_dir()]
    if not found:
        raise RacinesError(
            f"encoder {spec!r}: no pose regressor in {named}: run from the repository, train one "
            "with `racines train encoder`, or name its folder"
        )
    for folder in found:
        regressor = PoseRegressor.load(folder, device)
        if sha256 is None or regressor.sha256 == sha256:
            return PoseEncoder(regressor.network, regressor.sha256)
    searched = ", ".join(dict.fromkeys(map(str, found)))
    raise RacinesError(
        f"{near or spec}: the policy was trained with another encoder (sha256 {sha256}) than is in "
        f"{searched}; put that one into {near or spec}/{BESIDE}"
    )
