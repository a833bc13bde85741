"""A generator in an ONNX file: written from a trained one, and run by onnxruntime.

Of what is read, no code of the file's maker runs in Python. Inputs `parameters` float32 (B, 12),
or (B, 13) with the phase of the beat last, and, if the image has chance in it, `noise` float32
(B, K); one output `images`, (B, 128, 128) or (B, 1, 128, 128), uint8 gray levels or float32 in
[-1, 1]. What is written has the weights inside, interface and card in its metadata; what the file's
metadata say is in `docs/outside.md`.
"""

import copy
import json
import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from racines_data.errors import RacinesError
from racines_data.files import write_atomic
from racines_data.imaging import IMAGE_SIZE, conditions_for
from racines_data.randomness import sample_seeds
from racines_data.schema import PARAMETERS
from racines_models.exchange.naming import check_name
from racines_models.exchange.onnx.file import (
    FLOAT,
    MAX_BYTES,
    UINT8,
    check_value,
    declared_shape,
    import_onnx,
    open_session,
    parsed,
    read_metadata,
    read_model,
)
from racines_models.networks.painting import NoiseInput, OnnxModule
from racines_models.provenance import sha256_bytes

SCHEMA = "racines.onnx-generator/1"
PARAMS, NOISE, OUTPUT = "parameters", "noise", "images"
MAX_NOISE = 2**18
MAX_BATCH = 256
RANGES = {True: ("unit", "float32", "in [-1, 1]"), False: ("gray", "uint8", "gray levels 0-255")}
"""Of images that are floating or not: name in the metadata, element type, gray levels."""
KEYS = ("schema", "name", "output", "stochastic", "conditional", "noise", "card")
BATCH = {"cpu": 8, "cuda": 64}
"""Samples a call, by device type, where the graph leaves the batch free."""
SLACK = 1e-3
"""How far a float image may leave [-1, 1] by rounding."""
OPSET = 18
"""Operator set written: the oldest that torch's exporter targets natively."""
EXAMPLES = 2
"""Batch of the example inputs; the exported batch is free."""


_SAYS = ("stochastic", "conditional")
Opener = Callable[[bytes, str, str], Any]
"""Returns what has onnxruntime's `run` and `get_providers`."""


class OnnxGenerator:
    """Draws with the graph of one file, as `read_onnx` reads it.

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
        checked = conditions_for(parameters, self.interface.phased, self.name)
        checked = checked.to("cpu", torch.float32)
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
    stochastic: bool | None = None
    """Whether the seed changes the image, by metadata or card; None if neither says so."""
    conditional: bool | None = None
    """Whether the pose does, likewise."""
    phased: bool = False
    """Whether a 13th parameter is taken, the phase of the beat."""

    @property
    def trained(self) -> bool | None:
        """Whether another training of it would end elsewhere, by the card; None: untold."""
        return self.card.get("trained")


def read_onnx(path: Path) -> tuple[bytes, OnnxInterface]:
    """Return a file's bytes and what it says, if it meets the interface; nothing is run.

    Refused are files as by `read_model`, and wrong inputs, outputs and metadata.
    """
    content, model, opset = read_model(path)
    batch, size, phased = _inputs(model.graph, path)
    told = read_metadata(model, path, SCHEMA, KEYS)
    floating = _output(model.graph, told.get("output"), path)
    name = check_name(told.get("name", path.stem), f"{path}: racines.name")
    card = parsed(told, "card", dict, path) or {}
    noise = _noise(told, size, path)
    stochastic, conditional = (_declared(told, card, key, path) for key in _SAYS)
    says = stochastic, conditional, phased
    return content, OnnxInterface(name, noise, floating, batch, opset, card, *says)


def _declared(told: dict[str, str], card: dict[str, Any], key: str, path: Path) -> bool | None:
    value = parsed(told, key, bool, path)
    value = card.get(key) if value is None else value
    return value if isinstance(value, bool) else None


def _inputs(graph: Any, path: Path) -> tuple[int | None, int, bool]:
    """Return the fixed batch size, if any, the numbers of noise a sample, and whether it beats."""
    # Old files list their weights among the inputs.
    weights = {tensor.name for tensor in graph.initializer}
    inputs = {value.name: value for value in graph.input if value.name not in weights}
    if PARAMS not in inputs or not set(inputs) <= {PARAMS, NOISE}:
        wanted = f"give {PARAMS}, and {NOISE} if it is stochastic"
        raise RacinesError(f"{path}: inputs {sorted(inputs)}: {wanted}")
    count = len(PARAMETERS)
    phased = declared_shape(inputs[PARAMS])[-1] == count + 1
    count += phased
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
    return batch, size, phased


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


def export_generator(generator: Any, path: Path) -> dict[str, Any]:
    """Write a fitted generator as an ONNX file, with the interface that `OnnxGenerator` reads.

    Returns:
        What was written: path, size in bytes, opset, noise numbers a sample.

    Raises:
        RacinesError: the generator cannot be exported, or the optional packages are missing.
    """
    import_onnx("onnx", "onnxruntime", "onnxscript")
    hook = getattr(generator, "onnx_module", None)
    if hook is None:
        name = getattr(generator, "name", type(generator).__name__)
        remedy = "export its predictions instead: racines export predictions"
        raise RacinesError(f"{name} has no onnx_module(): it cannot be an ONNX file; {remedy}")
    if not getattr(generator, "tensors", lambda: True)():
        raise RacinesError(f"{generator.name} is not fitted: call fit, or load a trained folder")
    module: OnnxModule = hook()
    width = len(PARAMETERS) + bool(getattr(generator, "phased", False))
    examples = {PARAMS: torch.zeros(EXAMPLES, width)}
    if module.noise is not None:
        examples[NOISE] = torch.zeros(EXAMPLES, module.noise.size)
    card = asdict(generator.card)
    metadata = {
        "racines.schema": SCHEMA,
        "racines.name": card["name"],
        "racines.output": "gray",
        "racines.stochastic": json.dumps(card["stochastic"]),
        "racines.conditional": json.dumps(card["conditional"]),
        "racines.noise": json.dumps(asdict(module.noise) if module.noise else None),
        "racines.card": json.dumps(card),
    }
    written = write_onnx(module.network, examples, OUTPUT, metadata, path)
    return written | {"noise": module.noise.size if module.noise else 0}


def write_onnx(
    network: nn.Module,
    examples: dict[str, Tensor],
    output: str,
    metadata: dict[str, str],
    path: Path,
) -> dict[str, Any]:
    """Trace a network and write it as one file that opens without its code.

    The network takes the (2, …) `examples` by position, and is exported in float32, as in
    evaluation, for a batch of any size. The file says `metadata` of itself.

    Returns:
        Path, size in bytes, opset.

    Raises:
        RacinesError: it cannot be traced, is too large, or the optional packages are missing.
    """
    import_onnx("onnx", "onnxruntime", "onnxscript")
    model = _trace(network, examples, output)
    for key, value in metadata.items():
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value
    content = model.SerializeToString(deterministic=True)
    if len(content) > MAX_BYTES:
        raise RacinesError(
            f"{path}: the model would have {len(content):,} bytes, more than the {MAX_BYTES:,} "
            "that are read back: train a smaller one"
        )
    # The tracer can write graphs that do not load: none is left behind.
    open_session(content, f"{path}, exported,", "cpu")
    write_atomic(path, content)
    return {"out": str(path), "bytes": len(content), "opset": OPSET}


def _trace(network: nn.Module, examples: dict[str, Tensor], output: str) -> Any:
    traced = _Ordered(copy.deepcopy(network).cpu().float().eval())
    free = {0: torch.export.Dim.DYNAMIC}
    with _quiet(), torch.no_grad():
        try:
            program = torch.onnx.export(
                traced,
                tuple(examples.values()),
                input_names=list(examples),
                output_names=[output],
                dynamic_shapes=(tuple(free for _ in examples),),
                opset_version=OPSET,
                dynamo=True,
                verbose=False,
            )
        except Exception as error:
            name = type(network).__name__
            raise RacinesError(f"{name} cannot be traced to ONNX: {error}") from error
    assert program is not None
    model: Any = program.model_proto
    graph = model.graph
    values = [*graph.input, *graph.output, *graph.value_info, *graph.initializer]
    # The tracer's notes hold stack traces with paths of this machine.
    for part in [model, graph, *graph.node, *values]:
        part.doc_string = ""
        del part.metadata_props[:]
    return model


class _Ordered(nn.Module):
    """A network whose inputs come by position, whatever it calls them."""

    def __init__(self, network: nn.Module):
        super().__init__()
        self.network = network

    def forward(self, *inputs: Tensor) -> Tensor:
        return self.network(*inputs)


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence the tracer's remarks on packages that are absent and axes that it renamed."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings(action="ignore"):
            yield
    finally:
        logger.setLevel(level)
