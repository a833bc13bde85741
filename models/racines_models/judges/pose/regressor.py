"""The pose regressor: one ResNet that reads the probe's pose back from one image.

It measures what no likeness does: whether a drawn image shows the place that it was asked for. The
pose is not unique where nothing is seen (no contact), so errors are told as medians. Of patients it
reads the pose about the heart: where that lies in the chest cannot be seen.
"""

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.files import sha256_file, write_json
from racines_data.geometry import Pose, matrix_from_6d, parameters_to_pose, rotation_6d
from racines_data.imaging import IMAGE_SIZE, check_images
from racines_models.devices import resolve_device
from racines_models.judges.pose.frames import FRAMES
from racines_models.networks.batching import in_fixed_batches
from racines_models.training.augmentation import Augmentation
from racines_models.training.objective import Training
from racines_models.weights import load_network, read_described, save_weights

WEIGHTS = "model.safetensors"
CONFIG = "config.json"
SCHEMA = "racines.pose-regressor/1"
TARGETS = 9
"""Position (3) and the continuous rotation (6)."""
FEATURES = 512
"""Channels of the encoder's last map at width 1."""


@dataclass(frozen=True)
class PoseAugmentation(Augmentation):
    """Gain and noise, so that a drawn image's brightness is not taken for a place."""

    gain: float = 0.05
    tgc: float = 0.03
    gamma: float = 0.03
    blur: float = 0.1
    erase: float = 0.0
    noise: float = 0.02


@dataclass(frozen=True)
class PoseTraining(Training):
    """The trainer's settings (see `Training`) with the defaults of this task."""

    images: int = 240_000
    batch_size: int = 64
    schedule: str = "cosine"
    warmup_images: int = 6_400
    checkpoint_every: int = 20_000


@dataclass(frozen=True)
class PoseConfig:
    """The pose regressor and its training."""

    input_size: int = 64
    """Images are averaged down to this height and width: 64 or 128."""
    width: float = 0.5
    """Channels as a multiple of ResNet-18's."""
    learning_rate: float = 2e-3
    """Peak of AdamW's rate."""
    weight_decay: float = 0.01
    frame: str = "base"
    """What poses are told in: base, or heart, as whoever learns from patients does."""
    augmentation: PoseAugmentation = field(default_factory=PoseAugmentation)
    training: PoseTraining = field(default_factory=PoseTraining)

    def __post_init__(self) -> None:
        """Refuse a size that the network cannot take, and an unknown frame."""
        if self.input_size not in (64, 128):
            raise RacinesError(f"pose.input_size {self.input_size}: choose 64 or 128")
        if self.frame not in FRAMES:
            raise RacinesError(f"pose.frame {self.frame!r}: choose one of {', '.join(FRAMES)}")


class PoseNetwork(nn.Module):
    """ResNet-18 whose last map is flattened, not averaged: where a thing is seen is the answer.

    Owns the normalisation of images and of targets.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, input_size: int, width: float = 1.0):
        super().__init__()
        from monai.networks.nets.resnet import resnet18

        self.factor = IMAGE_SIZE // input_size
        shape: dict[str, Any] = {"spatial_dims": 2, "n_input_channels": 1, "conv1_t_stride": 2}
        self.encoder = resnet18(**shape, feed_forward=False, widen_factor=width)
        self.encoder.avgpool = nn.Flatten()  # pyright: ignore[reportAttributeAccessIssue]
        cells = (input_size // 32) ** 2
        self.head = nn.Linear(int(FEATURES * width) * cells, TARGETS)
        self.register_buffer("mean", torch.zeros(TARGETS))
        self.register_buffer("std", torch.ones(TARGETS))
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def fit_targets(self, parameters: Tensor) -> None:
        """Take mean and deviation of the targets of (N, 12) training parameters."""
        raw = _raw_targets(parameters.double())
        self.mean.copy_(raw.mean(0))
        self.std.copy_(raw.std(0).clamp_min(1e-6))

    def targets(self, parameters: Tensor) -> Tensor:
        """Return the (B, 9) standardised targets of (B, 12) parameters."""
        return (_raw_targets(parameters) - self.mean) / self.std

    def normalise(self, images: Tensor) -> Tensor:
        """Turn (B, 128, 128) gray levels, any type, into (B, 1, S, S) in [-1, 1]."""
        x = images.unsqueeze(1).to(torch.float32) / 127.5 - 1.0
        x = nn.functional.avg_pool2d(x, self.factor) if self.factor > 1 else x
        return x.contiguous(memory_format=torch.channels_last)

    def forward(self, x: Tensor) -> Tensor:
        """Return (B, 9) standardised targets of normalised images."""
        return self.head(self.encoder(x)).float()

    def pose(self, predicted: Tensor) -> Pose:
        """Turn (B, 9) standardised targets into poses, metres."""
        raw = predicted * self.std + self.mean
        return Pose(raw[:, :3], matrix_from_6d(raw[:, 3:]))


class PoseRegressor:
    """Reads poses from images.

    A pose depends on its image alone: not on its place, on its neighbours or on the size of the
    batch, to the last bit, on one machine.
    """

    def __init__(self, network: PoseNetwork, config: PoseConfig, device: str = "cpu"):
        self.device = torch.device(resolve_device(device))
        self.network = network.to(self.device).eval().requires_grad_(False)
        self.config = config
        self.sha256: str | None = None
        """Hash of the weights' file; None until saved or loaded."""

    @torch.inference_mode()
    def predict(self, images: Tensor) -> Pose:
        """Return the poses, on the CPU, that (N, 128, 128) uint8 images show, in `config.frame`."""
        network, images = self.network, check_images(images).to(self.device)
        # fp32: bfloat16 rounds a position by tenths of a millimetre.
        predicted = in_fixed_batches(lambda batch: network(network.normalise(batch)), images)
        return network.pose(predicted).to("cpu")

    @property
    def settings(self) -> dict[str, Any]:
        """What its figures depend on, for a scores file."""
        told = {
            "id": "racines-pose-resnet18",
            "sha256": self.sha256,
            "width": self.config.width,
            "resizer": f"area average, {IMAGE_SIZE} to {self.config.input_size}",
            "range": "gray 0-255, x / 127.5 - 1",
            "precision": "float32",
        }
        # Sealed records of the one heart name no frame.
        return told if self.config.frame == "base" else told | {"frame": self.config.frame}

    def save(self, folder: Path, **provenance: Any) -> None:
        """Write `model.safetensors`, then `config.json` with what `provenance` adds."""
        self.sha256 = save_weights(folder / WEIGHTS, self.network.state_dict())
        files = {WEIGHTS: {"bytes": (folder / WEIGHTS).stat().st_size, "sha256": self.sha256}}
        described = {"schema": SCHEMA, "config": asdict(self.config)}
        described |= {"weights_files": {"dtype": "float32", "files": files}}
        write_json(folder / CONFIG, described | provenance)

    @classmethod
    def load(cls, folder: Path | str, device: str = "cpu") -> "PoseRegressor":
        """Read what `save` wrote, or its half-precision copy; refused if absent or damaged."""
        folder = Path(folder)
        absent = "no pose regressor there; run: racines train pose"
        described = read_described(folder, absent, SCHEMA)
        config = fill(PoseConfig, described["config"], f"{folder / CONFIG}: config")
        network = PoseNetwork(config.input_size, config.width)
        load_network(folder / WEIGHTS, network, f"run: racines train pose --out {folder}")
        regressor = cls(network, config, device)
        regressor.sha256 = sha256_file(folder / WEIGHTS)
        return regressor


def _raw_targets(parameters: Tensor) -> Tensor:
    pose = parameters_to_pose(parameters)
    return torch.cat([pose.position, rotation_6d(pose.rotation)], -1)
