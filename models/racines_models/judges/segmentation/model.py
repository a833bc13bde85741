"""The segmentation judge: MONAI's U-Net (Kerfoot et al., 2019) over one image of one channel.

It outlines what it is shown and knows no pose. What it finds in a simulated frame is held against
the voxels that the beam went through, in a real one against what cardiologists drew.
"""

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.files import sha256_file, write_json
from racines_data.imaging import IMAGE_SIZE, check_images
from racines_models.devices import resolve_device
from racines_models.judges.segmentation.structures import STRUCTURES, relabel, to_camus
from racines_models.networks.batching import in_fixed_batches
from racines_models.training.augmentation import PARTS, Augmentation, StrongAugmentation
from racines_models.training.objective import Training
from racines_models.weights import load_network, read_described, save_weights

WEIGHTS = "model.safetensors"
CONFIG = "config.json"
SCHEMA = "racines.segmentation/1"
LEVELS = 5
"""Resolutions of the U-Net, each half of the one before."""


@dataclass(frozen=True)
class SegmentationTraining(Training):
    """The trainer's settings (see `Training`) with the defaults of this task."""

    images: int = 200_000
    batch_size: int = 16
    schedule: str = "cosine"
    warmup_images: int = 4_000
    sample_every: int = 20_000
    checkpoint_every: int = 4_000


@dataclass(frozen=True)
class SegmentationConfig:
    """The segmentation judge and its training."""

    structures: tuple[str, ...] = STRUCTURES
    """Labels of the masks that are outlined; all else is background."""
    input_size: int = 128
    """Images are averaged down to this height and width: 64 or 128."""
    channels: int = 16
    """At full resolution; each of the four levels below has twice as many."""
    patch: int = 1
    """Pixels along a side of the squares that the network takes as one, as channels (sub-pixel
    convolution, Shi et al., CVPR 2016): 2 costs half as much as 1, and outlines to the pixel."""
    learning_rate: float = 2e-3
    """Peak of AdamW's rate."""
    weight_decay: float = 0.01
    augmentation: Augmentation = field(default_factory=Augmentation)
    strong: StrongAugmentation = field(default_factory=lambda: StrongAugmentation(PARTS[:-1]))
    """All parts but the negatives: a picture upside down still has its ventricle."""
    training: SegmentationTraining = field(default_factory=SegmentationTraining)

    def __post_init__(self) -> None:
        """Refuse a size that the network cannot take."""
        if self.input_size not in (64, 128):
            raise RacinesError(f"segmentation.input_size {self.input_size}: choose 64 or 128")
        if self.patch not in (1, 2, 4):
            raise RacinesError(f"segmentation.patch {self.patch}: choose 1, 2 or 4")
        if self.channels < 1 or not self.structures:
            raise RacinesError("segmentation: channels and structures are at least 1")


class SegmentationNetwork(nn.Module):
    """MONAI's residual U-Net; owns the normalisation of images."""

    def __init__(self, config: SegmentationConfig) -> None:
        super().__init__()
        from monai.networks.nets.unet import UNet

        self.factor, self.patch = IMAGE_SIZE // config.input_size, config.patch
        self.net = UNet(
            spatial_dims=2,
            in_channels=config.patch**2,
            out_channels=(1 + len(config.structures)) * config.patch**2,
            channels=[config.channels << level for level in range(LEVELS)],
            strides=[2] * (LEVELS - 1),
            num_res_units=2,
            norm="batch",
        )

    def normalise(self, images: Tensor) -> Tensor:
        """Turn (B, 128, 128) gray levels, any type, into (B, 1, S, S) in [-1, 1]."""
        x = images.unsqueeze(1).to(torch.float32) / 127.5 - 1.0
        return nn.functional.avg_pool2d(x, self.factor) if self.factor > 1 else x

    def forward(self, x: Tensor) -> Tensor:
        """Return (B, structures + 1, 128, 128) logits of normalised images."""
        logits = self.net(nn.functional.pixel_unshuffle(x, self.patch))
        logits = nn.functional.pixel_shuffle(logits.float(), self.patch)
        if self.factor > 1:
            size = (IMAGE_SIZE, IMAGE_SIZE)
            logits = nn.functional.interpolate(logits, size, mode="bilinear")
        return logits


class SegmentationJudge:
    """Outlines structures.

    A mask depends on its image alone: not on its place, on its neighbours or on the size of the
    batch, to the last bit, on one machine.
    """

    def __init__(
        self, network: SegmentationNetwork, config: SegmentationConfig, device: str = "cpu"
    ) -> None:
        self.device = torch.device(resolve_device(device))
        self.network = network.to(self.device).eval().requires_grad_(False)
        self.config = config
        self.sha256: str | None = None
        """Hash of the weights' file; None until saved or loaded."""

    @property
    def structures(self) -> tuple[str, ...]:
        """Names of the numbers of its masks, from 1 on."""
        return self.config.structures

    @torch.inference_mode()
    def segment(self, images: Tensor) -> Tensor:
        """Return (N, 128, 128) uint8 masks, on the CPU, of (N, 128, 128) uint8 images.

        0 is background, 1 … the `structures`.
        """
        if not len(images):
            return torch.empty(0, IMAGE_SIZE, IMAGE_SIZE, dtype=torch.uint8)
        network, images = self.network, check_images(images).to(self.device)
        # fp32: bfloat16 would move edges, and with them volumes.
        return in_fixed_batches(
            lambda batch: network(network.normalise(batch)).argmax(1).to(torch.uint8), images
        ).cpu()

    def segment_camus(self, images: Tensor) -> Tensor:
        """Return the masks in CAMUS's numbers: 1 LV, 2 its myocardium, 3 LA."""
        return relabel(self.segment(images), to_camus(self.structures))

    @property
    def settings(self) -> dict[str, Any]:
        """What its figures depend on, for a scores file."""
        return {
            "id": "racines-segmentation-unet",
            "sha256": self.sha256,
            "structures": list(self.structures),
            "resizer": f"area average, {IMAGE_SIZE} to {self.config.input_size}",
            "range": "gray 0-255, x / 127.5 - 1",
            "precision": "float32",
        }

    def save(self, folder: Path, **provenance: Any) -> None:
        """Write `model.safetensors`, then `config.json` with what `provenance` adds."""
        self.sha256 = save_weights(folder / WEIGHTS, self.network.state_dict())
        files = {WEIGHTS: {"bytes": (folder / WEIGHTS).stat().st_size, "sha256": self.sha256}}
        described = {"schema": SCHEMA, "config": asdict(self.config)}
        described |= {"weights_files": {"dtype": "float32", "files": files}}
        write_json(folder / CONFIG, described | provenance)

    @classmethod
    def load(cls, folder: Path | str, device: str = "cpu") -> "SegmentationJudge":
        """Read what `save` wrote, or its half-precision copy; refused if absent or damaged."""
        folder = Path(folder)
        absent = f"no segmentation judge there; run: racines train segmentation --out {folder}"
        described = read_described(folder, absent, SCHEMA)
        config = fill(SegmentationConfig, described["config"], f"{folder / CONFIG}: config")
        network = SegmentationNetwork(config)
        remedy = f"run: racines train segmentation --out {folder}"
        load_network(folder / WEIGHTS, network, remedy)
        judge = cls(network, config, device)
        judge.sha256 = sha256_file(folder / WEIGHTS)
        return judge
