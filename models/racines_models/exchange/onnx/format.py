"""The interface of a generator in an ONNX file, and the checks that it is met.

Inputs `parameters` float32 (B, 12) and, if the image has chance in it, `noise` float32 (B, K); one
output `images`, (B, 128, 128) or (B, 1, 128, 128), uint8 gray levels or float32 in [-1, 1]. What
the file's metadata say is in `docs/outside.md`.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE
from racines_data.schema import PARAMETERS
from racines_models.exchange.naming import check_name
from racines_models.exchange.onnx.file import (
    FLOAT,
    UINT8,
    check_value,
    declared_shape,
    parsed,
    read_metadata,
    read_model,
)
from racines_models.networks.onnx_module import NoiseInput

SCHEMA = "racines.onnx-generator/1"
PARAMS, NOISE, OUTPUT = "parameters", "noise", "images"
MAX_NOISE = 2**18
MAX_BATCH = 256
RANGES = {True: ("unit", "float32", "in [-1, 1]"), False: ("gray", "uint8", "gray levels 0-255")}
"""Of images that are floating or not: name in the metadata, element type, gray levels."""
KEYS = ("schema", "name", "output", "stochastic", "noise", "card")


@dataclass(frozen=True)
class OnnxInterface:
    """What a checked file says of itself."""

    name: str
    noise: NoiseInput | None
    floating: bool
    """The output is float32 in [-1, 1], not uint8."""
    batch: int | None
    """The only batch size that the graph takes; None: any."""
    opset: int
    card: dict[str, Any] = field(default_factory=dict)
    """The generator's card, as the file has it; not checked."""


def read_onnx(path: Path) -> tuple[bytes, OnnxInterface]:
    """Return a file's bytes and what it says, if it meets the interface; nothing is run.

    Refused are files as by `read_model`, and wrong inputs, outputs and metadata.
    """
    content, model, opset = read_model(path)
    batch, size = _inputs(model.graph, path)
    told = read_metadata(model, path, SCHEMA, KEYS)
    floating = _output(model.graph, told.get("output"), path)
    name = check_name(told.get("name", path.stem), f"{path}: racines.name")
    card = parsed(told, "card", dict, path) or {}
    return content, OnnxInterface(name, _noise(told, size, path), floating, batch, opset, card)


def _inputs(graph: Any, path: Path) -> tuple[int | None, int]:
    """Return the fixed batch size, if any, and the numbers of noise a sample."""
    # Old files list their weights among the inputs.
    weights = {tensor.name for tensor in graph.initializer}
    inputs = {value.name: value for value in graph.input if value.name not in weights}
    if PARAMS not in inputs or not set(inputs) <= {PARAMS, NOISE}:
        wanted = f"give {PARAMS}, and {NOISE} if it is stochastic"
        raise RacinesError(f"{path}: inputs {sorted(inputs)}: {wanted}")
    count = len(PARAMETERS)
    batches = [check_value(inputs[PARAMS], path, f"float32 (B, {count})", (count,), (FLOAT,))]
    size = 0
    if NOISE in inputs:
        size = declared_shape(inputs[NOISE])[-1] or 0
        if not 1 <= size <= MAX_NOISE:
            raise RacinesError(f"{path}: {NOISE} has {size} numbers: give (B, 1..{MAX_NOISE})")
        batches.append(check_value(inputs[NOISE], path, "float32 (B, K)", (size,), (FLOAT,)))
    batch = next((size for size in batches if size is not None), None)
    if batch is not None and not 1 <= batch <= MAX_BATCH:
        raise RacinesError(f"{path}: a fixed batch of {batch}: give 1..{MAX_BATCH}, or a free one")
    return batch, size


def _output(graph: Any, declared: str | None, path: Path) -> bool:
    """Return whether the images are floating, by their type and by what the metadata declare."""
    names = [value.name for value in graph.output]
    if names != [OUTPUT]:
        raise RacinesError(f"{path}: outputs {names}: give one, {OUTPUT}")
    images, pixels = graph.output[0], (IMAGE_SIZE, IMAGE_SIZE)
    if len(declared_shape(images)) == 4:
        pixels = (1, *pixels)
    wanted = f"uint8 or float32 (B, {IMAGE_SIZE}, {IMAGE_SIZE})"
    check_value(images, path, wanted, pixels, (FLOAT, UINT8))
    floating = images.type.tensor_type.elem_type == FLOAT
    needed, kind, range_ = RANGES[floating]
    if declared != needed and (floating or declared is not None):
        told = "is absent" if declared is None else f"says {declared[:80]!r}"
        raise RacinesError(
            f"{path}: metadata racines.output {told}, but {OUTPUT} is {kind}: "
            f"set it to {needed!r} ({kind} {range_})"
        )
    return floating


def _noise(told: dict[str, str], size: int, path: Path) -> NoiseInput | None:
    declared = parsed(told, "noise", dict, path)
    stochastic = parsed(told, "stochastic", bool, path)
    if stochastic is not None and stochastic is not bool(size):
        has = f"the graph has {'a' if size else 'no'} {NOISE} input"
        raise RacinesError(f"{path}: racines.stochastic is {stochastic}, but {has}")
    if declared is None:
        return NoiseInput(size) if size else None
    keys = declared.get("keys", [])
    whole = isinstance(keys, list) and all(type(k) is int and abs(k) < 2**31 for k in keys)
    if set(declared) - {"size", "keys"} or not whole or declared.get("size") != size:
        wanted = f'{{"size": {size}, "keys": [integers]}}, the size of input {NOISE}'
        raise RacinesError(f"{path}: racines.noise: give {wanted}")
    return NoiseInput(size, tuple(keys))
