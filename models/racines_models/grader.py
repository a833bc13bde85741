"""The grader: one ResNet-18 that says which view an image shows, and how good it is.

After CACTUS (the paper's reference): one encoder, a view head and a grade head. It judges images
alone; what it should have said is the oracle's, or the expert's.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.files import sha256_file, write_atomic, write_json
from racines_data.imaging import IMAGE_SIZE
from racines_data.views import LABELS
from racines_models.grader_augment import Augmentation

WEIGHTS = "grader.safetensors"
CONFIG = "config.json"
SCHEMA = "racines.grader/1"
FEATURES = 512
"""Width of the encoder's output at width 1."""
GRADE_SCALE = 10.0
"""Grades lie in 0-10."""


@dataclass(frozen=True)
class StageConfig:
    """One stage of training: AdamW, one-cycle learning rate."""

    epochs: int = 4
    learning_rate: float = 2e-3
    encoder_rate: float = 1.0
    """The encoder's learning rate as a multiple of the heads'; 0 freezes it."""
    view_weight: float = 1.0
    """Weight of the view loss (cross-entropy)."""
    grade_weight: float = 0.0
    """Weight of the grade loss (smooth L1 in grades)."""


@dataclass(frozen=True)
class GradeStageConfig(StageConfig):
    """The transfer to grades; a class of its own, so that a params file may name some keys only."""

    epochs: int = 3
    learning_rate: float = 1e-3
    grade_weight: float = 0.5


@dataclass(frozen=True)
class GraderConfig(Augmentation):
    """The grader and its training, with the augmentation of its images."""

    input_size: int = 64
    """Images are averaged down to this height and width: 32, 64 or 128."""
    width: float = 1.0
    """Channels as a multiple of ResNet-18's."""
    batch_size: int = 64
    view_stage: StageConfig = field(default_factory=StageConfig)
    """First the views alone."""
    grade_stage: StageConfig = field(default_factory=GradeStageConfig)
    """Then the transfer to grades, on the views' encoder."""
    weight_decay: float = 0.01
    class_balance: float = 0.5
    """A view weighs its frequency to minus this power: 0 none, 1 full balance."""
    bf16: bool = True
    """Train and grade in bfloat16 autocast (twice as fast on recent CPUs)."""
    checkpoint_seconds: float = 30.0
    """Least time between two checkpoints."""

    def __post_init__(self) -> None:
        """Refuse a size that does not divide the image."""
        if self.input_size not in (32, 64, 128):
            raise RacinesError(f"grader.input_size {self.input_size}: choose 32, 64 or 128")


class GraderNetwork(nn.Module):
    """Encoder and heads; owns the normalisation of (B, 128, 128) uint8 images."""

    def __init__(self, input_size: int, width: float = 1.0, labels: int = len(LABELS)) -> None:
        super().__init__()
        from monai.networks.nets.resnet import resnet18

        self.factor = IMAGE_SIZE // input_size
        self.encoder = resnet18(
            spatial_dims=2,
            n_input_channels=1,
            conv1_t_stride=2,
            feed_forward=False,
            widen_factor=width,
        )
        self.features = int(FEATURES * width)
        self.view_head = nn.Linear(self.features, labels)
        self.grade_head = nn.Sequential(
            nn.Linear(self.features, 128), nn.ReLU(inplace=True), nn.Linear(128, 1)
        )
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def normalise(self, images: Tensor) -> Tensor:
        """Turn (B, 128, 128) gray levels, any type, into (B, 1, S, S) in [-1, 1]."""
        x = images.unsqueeze(1).to(torch.float32) / 127.5 - 1.0
        x = nn.functional.avg_pool2d(x, self.factor) if self.factor > 1 else x
        return x.contiguous(memory_format=torch.channels_last)

    def heads(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Return (B, labels) view logits and (B,) unclamped grades of (B, 512) features."""
        grade = self.grade_head(features).squeeze(-1)
        return self.view_head(features), GRADE_SCALE * grade.float()

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Return (B, labels) view logits and (B,) grades of normalised images."""
        return self.heads(self.encoder(x))


class Grader:
    """Labels and grades images.

    Raises:
        RacinesError: `load` finds no grader, or one of another kind.
    """

    def __init__(
        self,
        network: GraderNetwork,
        config: GraderConfig,
        device: str = "cpu",
        labels: Sequence[str] = LABELS,
    ) -> None:
        self.network = network.to(device).eval().requires_grad_(False)
        self.config = config
        self.labels = tuple(labels)
        """Names of the view labels, in the order of its probabilities; the last is `Random`."""
        self.device = torch.device(device)
        self.sha256: str | None = None
        """Hash of the weights' file; None until saved or loaded."""

    @torch.inference_mode()
    def probabilities_and_grade(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Judge (B, 128, 128) uint8 images.

        Returns:
            (B, labels) float32 probabilities in the order of `labels`, and (B,) float32 grades in
            0-10, on the grader's device.
        """
        with self._autocast():
            logits, grade = self.network(self._input(images))
        return logits.float().softmax(-1), grade.clamp(0.0, GRADE_SCALE)

    @torch.inference_mode()
    def features(self, images: Tensor) -> Tensor:
        """Return the encoder's (B, 512) float32 output on (B, 128, 128) uint8 images."""
        with self._autocast():
            return self.network.encoder(self._input(images)).float()

    @torch.inference_mode()
    def judge(self, images: Tensor, batch_size: int = 256) -> tuple[Tensor, Tensor, Tensor]:
        """Return (N,) labels, (N,) grades and (N, 512) features on the CPU, in one pass."""
        parts = []
        for batch in images.split(batch_size):
            with self._autocast():
                features = self.network.encoder(self._input(batch))
                logits, grade = self.network.heads(features)
            grade = grade.clamp(0.0, GRADE_SCALE)
            parts.append((logits.argmax(-1).cpu(), grade.cpu(), features.float().cpu()))
        if not parts:
            return torch.empty(0, dtype=torch.int64), torch.empty(0), torch.empty(0, 0)
        labels, grades, features = (torch.cat(column) for column in zip(*parts, strict=True))
        return labels, grades, features

    @property
    def settings(self) -> dict[str, Any]:
        """What its features depend on, for a scores file."""
        return {
            "id": "racines-grader-resnet18",
            "sha256": self.sha256,
            "layer": f"encoder, {self.network.features}",
            "resizer": f"area average, {IMAGE_SIZE} to {self.config.input_size}",
            "range": "gray 0-255, x / 127.5 - 1",
            "precision": "bfloat16 autocast" if self.config.bf16 else "float32",
        }

    def save(self, folder: Path, **provenance: Any) -> None:
        """Write `grader.safetensors`, then `config.json` with what `provenance` adds."""
        from safetensors.torch import save

        state = {k: v.contiguous().cpu() for k, v in self.network.state_dict().items()}
        write_atomic(folder / WEIGHTS, save(state))
        self.sha256 = sha256_file(folder / WEIGHTS)
        described = {"schema": SCHEMA, "config": asdict(self.config), "sha256": self.sha256}
        write_json(folder / CONFIG, described | {"labels": list(self.labels)} | provenance)

    @classmethod
    def load(cls, folder: Path | str, device: str = "cpu") -> "Grader":
        """Read what `save` wrote; the weights must have the hash that the config names."""
        from safetensors.torch import load_file

        folder = Path(folder)
        described = _read_config(folder)
        config = fill(GraderConfig, described["config"], f"{folder / CONFIG}: config")
        path = folder / WEIGHTS
        if not path.is_file() or sha256_file(path) != described["sha256"]:
            raise RacinesError(f"{path}: missing or damaged; run: racines train grader")
        labels = described.get("labels") or LABELS  # graders of old are cardiac
        network = GraderNetwork(config.input_size, config.width, len(labels))
        network.load_state_dict(load_file(path))
        grader = cls(network, config, device, labels)
        grader.sha256 = described["sha256"]
        return grader

    def check_labels(self, labels: Sequence[str], what: str) -> None:
        """Check that the grader knows these labels, those of `what`, in this order.

        Raises:
            RacinesError: it was trained for other views.
        """
        if self.labels != tuple(labels):
            raise RacinesError(
                f"the grader knows {', '.join(self.labels)}, {what} has {', '.join(labels)}: train "
                "a grader on a dataset of that anatomy: racines train grader"
            )

    def _input(self, images: Tensor) -> Tensor:
        return self.network.normalise(images.to(self.device))

    def _autocast(self) -> torch.autocast:
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.config.bf16)


def _read_config(folder: Path) -> dict[str, Any]:
    path = folder / CONFIG
    if not path.is_file():
        raise RacinesError(f"{folder}: no grader there; run: racines train grader --out {folder}")
    try:
        described = json.loads(path.read_text())
    except json.JSONDecodeError as error:
        raise RacinesError(f"{path}: not valid JSON: {error}") from error
    if described.get("schema") != SCHEMA:
        raise RacinesError(f"{path}: schema {described.get('schema')!r}, expected {SCHEMA!r}")
    return described
