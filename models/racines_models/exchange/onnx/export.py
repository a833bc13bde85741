"""A trained generator as one ONNX file: weights inside, interface and card in its metadata."""

import copy
import dataclasses
import json
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import nn

from racines_data.errors import RacinesError
from racines_data.files import write_atomic
from racines_data.schema import PARAMETERS
from racines_models.exchange.onnx.file import MAX_BYTES, import_onnx, open_session
from racines_models.exchange.onnx.generator import NOISE, OUTPUT, PARAMS, SCHEMA
from racines_models.networks.onnx_module import OnnxModule

OPSET = 18
"""Operator set written: the oldest that torch's exporter targets natively."""
EXAMPLES = 2
"""Batch of the example inputs; the exported batch is free."""


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
    examples = {PARAMS: torch.zeros(EXAMPLES, len(PARAMETERS))}
    if module.noise is not None:
        examples[NOISE] = torch.zeros(EXAMPLES, module.noise.size)
    card = dataclasses.asdict(generator.card)
    metadata = {
        "racines.schema": SCHEMA,
        "racines.name": card["name"],
        "racines.output": "gray",
        "racines.stochastic": json.dumps(card["stochastic"]),
        "racines.noise": json.dumps(dataclasses.asdict(module.noise) if module.noise else None),
        "racines.card": json.dumps(card),
    }
    written = write_onnx(module.network, examples, OUTPUT, metadata, path)
    return written | {"noise": module.noise.size if module.noise else 0}


def write_onnx(
    network: nn.Module,
    examples: dict[str, torch.Tensor],
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


def _trace(network: nn.Module, examples: dict[str, torch.Tensor], output: str) -> Any:
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

    def forward(self, *inputs: torch.Tensor) -> torch.Tensor:
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
