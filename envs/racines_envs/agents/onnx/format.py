"""The interface of a policy in an ONNX file, and the checks that it is met.

Inputs `image` uint8 (B, 128, 128) and/or `params` float32 (B, 9), as the environment shows them;
one output `logits` float32 (B, 13), the greatest of which is the action. What the file's metadata
say is in `docs/agents.md`.
"""

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE
from racines_envs.task.actions import ACTIONS
from racines_envs.task.core import PARAMS_SIZE
from racines_models.exchange.naming import check_name
from racines_models.exchange.onnx.file import (
    FLOAT,
    UINT8,
    check_value,
    parsed,
    read_metadata,
    read_model,
)

SCHEMA = "racines.onnx-policy/1"
IMAGE, PARAMS, OUTPUT = "image", "params", "logits"
MAX_BATCH = 256
KEYS = ("schema", "name", "view", "temperature", "card")
INPUTS = {
    IMAGE: (f"uint8 (B, {IMAGE_SIZE}, {IMAGE_SIZE})", (IMAGE_SIZE, IMAGE_SIZE), (UINT8,)),
    PARAMS: (f"float32 (B, {PARAMS_SIZE})", (PARAMS_SIZE,), (FLOAT,)),
}
"""By name: what is wanted, sizes after the batch, element types."""
OBSERVATIONS = {
    frozenset([IMAGE]): "image",
    frozenset([PARAMS]): "params",
    frozenset([IMAGE, PARAMS]): "multimodal",
}


@dataclass(frozen=True)
class PolicyInterface:
    """What a checked file says of itself."""

    name: str
    view: str | None
    """The view that it was trained for; None if the file does not say."""
    observation: str
    """`image`, `params` or `multimodal`, by its inputs."""
    temperature: float
    """Actions are drawn from softmax(logits / temperature); 0: the greatest."""
    batch: int | None
    """The only batch size that the graph takes; None: any."""
    opset: int
    card: dict[str, Any] = field(default_factory=dict)
    """The policy's card, as the file has it; not checked."""


def read_policy(path: Path) -> tuple[bytes, PolicyInterface]:
    """Read a file and check that it meets the interface, without running it.

    Raises:
        RacinesError: the file is refused (see `racines_models.exchange.onnx.file.read_model`), or
            its inputs, output or metadata.
    """
    content, model, opset = read_model(path)
    observation, batch = _inputs(model.graph, path)
    names = [value.name for value in model.graph.output]
    if names != [OUTPUT]:
        raise RacinesError(f"{path}: outputs {names}: give one, {OUTPUT}")
    wanted = f"float32 (B, {len(ACTIONS)})"
    check_value(model.graph.output[0], path, wanted, (len(ACTIONS),), (FLOAT,))
    told = read_metadata(model, path, SCHEMA, KEYS)
    name = check_name(told.get("name", path.stem), f"{path}: racines.name")
    card = parsed(told, "card", dict, path) or {}
    interface = PolicyInterface(
        name, told.get("view"), observation, _temperature(told, path), batch, opset, card
    )
    return content, interface


def _inputs(graph: Any, path: Path) -> tuple[str, int | None]:
    """Return the observation, and the fixed batch size, if any."""
    # Old files list their weights among the inputs.
    weights = {tensor.name for tensor in graph.initializer}
    inputs = {value.name: value for value in graph.input if value.name not in weights}
    observation = OBSERVATIONS.get(frozenset(inputs))
    if observation is None:
        raise RacinesError(f"{path}: inputs {sorted(inputs)}: give {IMAGE}, {PARAMS}, or both")
    batches = {check_value(value, path, *INPUTS[name]) for name, value in inputs.items()}
    batch = next((size for size in batches if size is not None), None)
    if batch is not None and not 1 <= batch <= MAX_BATCH:
        raise RacinesError(f"{path}: a fixed batch of {batch}: give 1..{MAX_BATCH}, or a free one")
    return observation, batch


def _temperature(told: dict[str, str], path: Path) -> float:
    try:
        value = float(json.loads(told.get("temperature", "0")))
    except (TypeError, ValueError, RecursionError) as error:
        raise RacinesError(f"{path}: racines.temperature: no number: {error}") from error
    if not (math.isfinite(value) and value >= 0):
        raise RacinesError(f"{path}: racines.temperature is {value}: give 0 or more")
    return value
