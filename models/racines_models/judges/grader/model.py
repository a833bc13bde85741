"""The grader: one ResNet-18 that says which view an image shows, and how good it is.

After CACTUS (the paper's reference): one encoder, a view head and a grade head. It judges images
alone; what it should have said is the oracle's, or the expert's. Its student is opened by the same
`Grader.load` and asked the same way.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from racines_data.config import Settings, fill
from racines_data.errors import RacinesError
from racines_data.files import sha256_file, write_json
from racines_data.plugins import Plugins
from racines_data.views import LABELS
from racines_models.devices import resolve_device
from racines_models.networks.batching import in_fixed_batches
from racines_models.networks.grading import GRADE_SCALE, GraderNetwork, GradingNetwork
from racines_models.protocol import Judge
from racines_models.training.augmentation import Augmentation, StrongAugmentation
from racines_models.weights import load_network, read_described, save_weights

WEIGHTS = "grader.safetensors"
CONFIG = "config.json"
SCHEMA = "racines.grader/1"
JUDGES = Plugins("architecture", "racines.judges", ("architecture", "Config", "build"), or_give="")
"""Who reads a folder, by the architecture that its config names: a file names no module."""


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
    strong: StrongAugmentation = field(default_factory=StrongAugmentation)
    """What goes beyond the simulator, for real frames; no part of it is on."""
    bf16: bool = True
    """Grade in bfloat16 autocast, and train so where the processor has units for it (twice as
    fast); where it has none, training is in float32, and grading rounds as those units do."""
    ema: float = 0.0
    """Decay of the averaged weights that are kept; 0, none, as the rate ends at zero anyway."""
    checkpoint_seconds: float = 30.0
    """Least time between two checkpoints."""

    def __post_init__(self) -> None:
        """Refuse a size that does not divide the image."""
        if self.input_size not in (32, 64, 128):
            raise RacinesError(f"grader.input_size {self.input_size}: choose 32, 64 or 128")


class Reading(NamedTuple):
    """What a grader makes of (N, 128, 128) images."""

    logits: Tensor
    """(N, labels) float32, before the temperature."""
    grades: Tensor
    """(N,) float32 in 0-10."""
    features: Tensor
    """(N, D) float32, the encoder's output."""


class Grader(Judge):
    """Labels and grades images.

    What it says of an image depends on that image alone: not on its place, on its neighbours or on
    the size of the batch, to the last bit, on one machine.
    """

    architecture: ClassVar[str] = "resnet18"
    Config: ClassVar[type] = GraderConfig
    network: GradingNetwork

    def __init__(
        self,
        network: GradingNetwork,
        config: Any,
        device: str = "cpu",
        labels: Sequence[str] = LABELS,
        temperature: float = 1.0,
    ) -> None:
        self.device = torch.device(resolve_device(device))
        self.network = network.to(self.device).eval().requires_grad_(False)
        self.config = config
        self.labels = tuple(labels)
        """Names of the view labels, in the order of its probabilities; the last is `Random`."""
        self.temperature = temperature
        """Divides the logits of the views, so that the probabilities are calibrated."""
        self.sha256: str | None = None
        """Hash of the weights' file; None until saved or loaded."""

    @classmethod
    def build(cls, config: Any, labels: int) -> GradingNetwork:
        """Return an untrained network."""
        return GraderNetwork(config.input_size, config.width, labels)

    @classmethod
    def begin(cls, network: GradingNetwork, config: Any) -> dict[str, Any]:
        """Give an untrained network what its training begins from, and say what that is."""
        return {}

    @torch.inference_mode()
    def probabilities_and_grade(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Return (B, labels) calibrated probabilities and (B,) grades in 0-10 of uint8 images.

        The images are (B, 128, 128); both answers are float32, on the grader's device.
        """
        logits, grades, _ = self._read(images)
        return (logits / self.temperature).softmax(-1), grades

    @torch.inference_mode()
    def features(self, images: Tensor) -> Tensor:
        """Return the encoder's (B, D) float32 output on (B, 128, 128) uint8 images."""
        return self._read(images).features

    @torch.inference_mode()
    def read(self, images: Tensor, batch_size: int = 256) -> Reading:
        """Return logits, grades and features of (N, 128, 128) uint8 images, on the CPU."""
        parts = [[t.cpu() for t in self._read(batch)] for batch in images.split(batch_size)]
        return Reading(*(torch.cat(column) for column in zip(*parts, strict=True)))

    def judge(self, images: Tensor, batch_size: int = 256) -> tuple[Tensor, Tensor, Tensor]:
        """Return (N,) labels, (N,) grades and (N, D) features on the CPU, in one pass."""
        if not len(images):
            return torch.empty(0, dtype=torch.int64), torch.empty(0), torch.empty(0, 0)
        logits, grades, features = self.read(images, batch_size)
        return logits.argmax(-1), grades, features

    @property
    def settings(self) -> dict[str, Any]:
        """What its features depend on, for a scores file."""
        return {
            "id": f"racines-grader-{self.architecture}",
            "sha256": self.sha256,
            "layer": f"encoder, {self.network.features}",
            "resizer": f"area average, 128 to {self.config.input_size}",
            "range": "gray 0-255, x / 127.5 - 1",
            "precision": "bfloat16 autocast" if self.config.bf16 else "float32",
        }

    def save(self, folder: Path, **provenance: Any) -> None:
        """Write `grader.safetensors`, then `config.json` with what `provenance` adds."""
        self.sha256 = save_weights(folder / WEIGHTS, self.network.state_dict())
        described = {"schema": SCHEMA, "architecture": self.architecture}
        described |= {"config": asdict(self.config), "sha256": self.sha256}
        described |= {"labels": list(self.labels), "temperature": self.temperature}
        write_json(folder / CONFIG, described | provenance)

    @classmethod
    def load(cls, folder: Path | str, device: str = "cpu") -> "Grader":
        """Read what `save` wrote, of either architecture, or its half-precision copy.

        Raises:
            RacinesError: no grader, one of another kind, or weights that the config does not name.
        """
        folder = Path(folder)
        described = read_config(folder)
        try:
            kind = JUDGES.load(described.get("architecture", cls.architecture))
        except RacinesError as error:
            raise RacinesError(f"{folder / CONFIG}: {error}") from error
        config = fill(kind.Config, described["config"], f"{folder / CONFIG}: config")
        path, files = folder / WEIGHTS, described.get("weights_files", {}).get("files", {})
        digest = files.get(WEIGHTS, {}).get("sha256", described["sha256"])
        if not path.is_file() or sha256_file(path) != digest:
            raise RacinesError(f"{path}: missing or damaged; run: racines train grader")
        labels = described.get("labels") or LABELS  # graders of old are cardiac
        network = kind.build(config, len(labels))
        load_network(path, network, "run: racines train grader")
        grader = kind(network, config, device, labels, described.get("temperature", 1.0))
        grader.sha256 = digest
        return grader

    def _read(self, images: Tensor) -> Reading:
        normalise, images = self.network.normalise, images.to(self.device)
        return Reading(*in_fixed_batches(lambda batch: self.answer(normalise(batch)), images))

    def answer(self, x: Tensor) -> Reading:
        """Return logits, grades and features of normalised (B, 1, S, S) images."""
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.config.bf16):
            features = self.network.encoder(x)
            logits, grades = self.network.heads(features)
        return Reading(logits.float(), grades.clamp(0.0, GRADE_SCALE), features.float())


def grader_of(stated: Settings) -> tuple[type[Grader], Settings]:
    """Return the class that the key `architecture` of settings names, and the other settings.

    Raises:
        RacinesError: an unknown architecture, or a judge that is not trained as a grader is.
    """
    named = stated.get("architecture", Grader.architecture)
    kind = JUDGES.load(named)
    if not issubclass(kind.Config, GraderConfig):
        raise RacinesError(
            f"grader.architecture {named!r}: is not trained from the truth, in two stages; leave "
            f"it out for {Grader.architecture}"
        )
    return kind, stated.of(*(key for key in stated if key != "architecture"))


def read_config(folder: Path) -> dict[str, Any]:
    """Return what a grader's `config.json` says; refused if absent or of another schema."""
    absent = f"no grader there; run: racines train grader --out {folder}"
    return read_described(folder, absent, SCHEMA)
