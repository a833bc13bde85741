"""A quick look at a generator while it trains; the published scores are made elsewhere."""

from pathlib import Path
from typing import Any

import torch
from PIL import Image
from torch import Tensor

from racines_data.files import image_bytes, write_atomic
from racines_data.imaging import ImageSource
from racines_data.store.frames import FrameStore

FRAMES, COLUMNS = 64, 8
"""Frames judged, and frames drawn in a grid."""


class Validation:
    """Some frames of the validation split, evenly spread (of train, where that split is empty)."""

    def __init__(self, store: FrameStore, seed: int):
        frames = store.split_indices("validation")
        self.split = "validation" if len(frames) else "train"
        frames = store.split_indices(self.split).sort().values
        count = min(FRAMES, len(frames))
        frames = frames[torch.arange(count) * len(frames) // count]
        self._truth, self._parameters, *_ = store.take(frames)
        self._seed = seed

    def draw(self, generator: ImageSource) -> Tensor:
        """Return the generator's (n, 128, 128) images of the frames' parameters."""
        return generator.generate(self._parameters, self._seed)

    def figures(self, drawn: Tensor) -> dict[str, Any]:
        """Return split, n, mean absolute error in gray levels, and mean PSNR over frames in dB."""
        error = drawn.double() - self._truth.double()
        power = error.square().mean((1, 2)).clamp_min(1e-3)
        psnr = (10.0 * torch.log10(255.0**2 / power)).mean()
        return {
            "split": self.split,
            "n": len(drawn),
            "mae": float(error.abs().mean()),
            "psnr": float(psnr),
        }

    def grid(self, drawn: Tensor, path: Path) -> None:
        """Write a PNG: the truth above, the drawn images below."""
        chosen = torch.arange(min(COLUMNS, len(drawn))) * len(drawn) // min(COLUMNS, len(drawn))
        rows = [torch.cat(list(images[chosen]), 1) for images in (self._truth, drawn)]
        write_atomic(path, image_bytes(Image.fromarray(torch.cat(rows).numpy())))
