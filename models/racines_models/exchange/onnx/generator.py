"""A generator in an ONNX file, run by onnxruntime: no code of the file's maker in Python."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE, check_parameters
from racines_data.randomness import sample_seeds
from racines_models.exchange.onnx.file import open_session
from racines_models.exchange.onnx.format import NOISE, OUTPUT, PARAMS, read_onnx
from racines_models.provenance import sha256_bytes

BATCH = {"cpu": 8, "cuda": 64}
"""Samples a call, by device type, where the graph leaves the batch free."""
SLACK = 1e-3
"""How far a float image may leave [-1, 1] by rounding."""

Opener = Callable[[bytes, str, str], Any]
"""Returns what has onnxruntime's `run` and `get_providers`."""


class OnnxGenerator:
    """Draws with the graph of one file; `racines_models.exchange.onnx.format` has its interface.

    Batches have one size, the last one padded, so that an image ignores its neighbours; onnxruntime
    runs on one thread in its deterministic mode. On `cuda` its CUDA provider runs if installed.
    """

    def __init__(self, path: Path, device: str = "cpu", opener: Opener = open_session):
        """Open a file; `opener` makes of its bytes, its name and the device what runs it.

        Raises:
            RacinesError: the file is refused, or onnxruntime cannot load it.
        """
        self.path = Path(path)
        content, self.interface = read_onnx(self.path)
        self.name = self.interface.name
        self.sha256 = sha256_bytes(content)
        self._session = opener(content, str(self.path), device)
        self.provider: str = self._session.get_providers()[0]
        kind = "cuda" if self.provider.startswith("CUDA") else "cpu"
        self._batch = self.interface.batch or BATCH[kind]

    def generate(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        """Return (B, 128, 128) uint8 images, on the parameters' device (see `ImageSource`).

        Raises:
            RacinesError: parameters that are refused, or an output of wrong shape or range.
        """
        checked = check_parameters(parameters).to("cpu", torch.float32)
        inputs = {PARAMS: checked}
        if self.interface.noise is not None:
            seeds = sample_seeds(seed, len(checked), parameters.device).cpu()
            inputs[NOISE] = self.interface.noise.draw(seeds)
        drawn = [self._run(inputs, start) for start in range(0, len(checked), self._batch)]
        empty = torch.empty(0, IMAGE_SIZE, IMAGE_SIZE, dtype=torch.uint8)
        return torch.cat([empty, *drawn]).to(parameters.device)

    def _run(self, inputs: dict[str, Tensor], start: int) -> Tensor:
        left = len(inputs[PARAMS]) - start
        # The last sample again, not zeros: the graph need not bear a pose that no probe has.
        rows = start + torch.arange(self._batch).clamp_max(left - 1)
        chunk = {key: value[rows].numpy() for key, value in inputs.items()}
        try:
            (images,) = self._session.run([OUTPUT], chunk)
        except RacinesError:
            raise
        except Exception as error:
            raise RacinesError(f"{self.path}: onnxruntime failed: {error}") from error
        count = self._batch
        if images.size != count * IMAGE_SIZE**2 or images.shape[0] != count:
            came = f"{OUTPUT} came with shape {images.shape} for {count} poses"
            raise RacinesError(f"{self.path}: {came}: give (B, {IMAGE_SIZE}, {IMAGE_SIZE})")
        drawn = torch.from_numpy(images.reshape(count, IMAGE_SIZE, IMAGE_SIZE))
        if not self.interface.floating:
            return drawn[:left]
        low, high = float(drawn.min()), float(drawn.max())
        if not (low >= -1 - SLACK and high <= 1 + SLACK):  # false for NaN, too
            came = f"{OUTPUT} lies in {low:g} to {high:g}"
            raise RacinesError(f"{self.path}: {came}: give finite values in [-1, 1]")
        return ((drawn + 1.0) * 127.5).round().clamp(0, 255).to(torch.uint8)[:left]
