"""Feature extractors behind one call, and the reference's features kept between runs."""

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
from racines_models.judges.grader.model import Grader
from racines_models.provenance import sha256_bytes
from racines_models.sample import Progress


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


def features_of_sets(
    extractor: Extractor, sets: list[Tensor], progress: Progress | None = None
) -> list[Tensor]:
    """Return the (N, D) features of sets of (N, 128, 128) images, each image looked at once.

    A generator without noise draws every seed's set alike, and the mean image is one image.
    """
    places: dict[bytes, int] = {}
    index = [places.setdefault(image.numpy().tobytes(), len(places)) for image in torch.cat(sets)]
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

    The file's name is a hash of `key`, which says all that the tensor depends on.
    """
    if folder is None:
        return make()
    path = folder / f"{sha256_bytes(json.dumps(key, sort_keys=True).encode())[:32]}.safetensors"
    try:
        return load_file(path)["features"]
    except (SafetensorError, KeyError, OSError):  # absent, or damaged
        tensor = make()
        write_atomic(path, save({"features": tensor.contiguous()}))
        return tensor
