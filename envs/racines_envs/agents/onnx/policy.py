"""A policy in an ONNX file: how it is written, checked, and acted by.

Inputs `image` uint8 (B, 128, 128) and/or `params` float32 (B, 9), as the environment shows them;
one output `logits` float32 (B, 13), the greatest of which is the action, or `twist` float32 (B, 6),
m/s and rad/s in the probe's frame, cut at the task's limits. What the file's metadata say is in
`docs/agents.md`. It is run by onnxruntime: no code of the file's maker in Python.
"""

import json
import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import torch
from torch import Tensor, nn

from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE
from racines_envs.agents.networks import SEEN
from racines_envs.agents.policy import PolicyAgent, actor_logits, choose
from racines_envs.agents.protocol import Untrained, acts, agent_class
from racines_envs.task.actions import ACTIONS
from racines_envs.task.core import PARAMS_SIZE
from racines_envs.task.motion import DISCRETE, VELOCITY, Velocity
from racines_envs.worlds.making import find_task
from racines_models.exchange.naming import check_name
from racines_models.exchange.onnx import file
from racines_models.exchange.onnx.file import open_session
from racines_models.exchange.onnx.generator import EXAMPLES, Opener, write_onnx
from racines_models.provenance import code_version, sha256_bytes
from racines_models.weights import read_described

SCHEMA = "racines.onnx-policy/1"
IMAGE, PARAMS, LOGITS, TWIST = "image", "params", "logits", "twist"
OUTPUTS = {LOGITS: len(ACTIONS), TWIST: 6}
"""Numbers a row, by the output's name."""
MAX_BATCH = 256
KEYS = ("schema", "name", "view", "temperature", "card")
INPUTS = {
    IMAGE: (f"uint8 (B, {IMAGE_SIZE}, {IMAGE_SIZE})", (IMAGE_SIZE, IMAGE_SIZE), (file.UINT8,)),
    PARAMS: (f"float32 (B, {PARAMS_SIZE})", (PARAMS_SIZE,), (file.FLOAT,)),
}
"""By name: what is wanted, sizes after the batch, element types."""
BATCH = 8
"""Rows a call where the graph leaves the batch free."""
FILE = "policy.onnx"
"""The file that is looked for in a folder."""


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
    output: str
    """`logits` of the thirteen steps, or `twist`."""
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
    content, model, opset = file.read_model(path)
    observation, batch = _inputs(model.graph, path)
    names = [value.name for value in model.graph.output]
    if len(names) != 1 or names[0] not in OUTPUTS:
        raise RacinesError(f"{path}: outputs {names}: give one, {' or '.join(OUTPUTS)}")
    output, width = names[0], OUTPUTS[names[0]]
    wanted = f"float32 (B, {width})"
    file.check_value(model.graph.output[0], path, wanted, (width,), (file.FLOAT,))
    told = file.read_metadata(model, path, SCHEMA, KEYS)
    name = check_name(told.get("name", path.stem), f"{path}: racines.name")
    card = file.parsed(told, "card", dict, path) or {}
    temperature = _temperature(told, path)
    if output == TWIST and temperature:
        raise RacinesError(f"{path}: racines.temperature is {temperature}: a twist is not drawn")
    interface = PolicyInterface(
        name, told.get("view"), observation, temperature, output, batch, opset, card
    )
    return content, interface


def _inputs(graph: Any, path: Path) -> tuple[str, int | None]:
    """Return the observation, and the fixed batch size, if any."""
    # Old files list their weights among the inputs.
    weights = {tensor.name for tensor in graph.initializer}
    inputs = {value.name: value for value in graph.input if value.name not in weights}
    observation = next((name for name, keys in SEEN.items() if set(keys) == set(inputs)), None)
    if observation is None:
        raise RacinesError(f"{path}: inputs {sorted(inputs)}: give {IMAGE}, {PARAMS}, or both")
    batches = {file.check_value(value, path, *INPUTS[name]) for name, value in inputs.items()}
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


class OnnxPolicyAgent(Untrained):
    """Acts by the graph of one file (see `read_policy`).

    Calls have one size, the last one padded, so that a row's action ignores its batch; onnxruntime
    runs on one thread in its deterministic mode.

    Raises:
        RacinesError: the file is refused, or onnxruntime cannot load it.
    """

    name: ClassVar[str] = "onnx"
    origin: ClassVar[str] = (
        "train another and export it: racines export agent RUN --out policy.onnx"
    )
    observation: str = "image"

    def __init__(
        self, path: Path | str, device: torch.device | str = "cpu", opener: Opener = open_session
    ) -> None:
        """Open a file; `opener` makes of its bytes, its name and the device what runs it."""
        self.path = Path(path)
        content, self.interface = read_policy(self.path)
        self.sha256 = sha256_bytes(content)
        """Hash of the file."""
        self.observation = self.interface.observation
        # Whoever made it learned it, unless the card says that it did not.
        self.trained = self.interface.card.get("trained") is not False
        if self.interface.view is not None:
            self.view = self.interface.view
        self.action = VELOCITY if self.interface.output == TWIST else DISCRETE
        self._limits = Velocity(find_task(self.interface.view or "SC"), "cpu").limits
        self._session = opener(content, str(self.path), str(device))
        twists = self.interface.output == TWIST
        self._batch = self.interface.batch or (1 if twists else BATCH)
        # The greatest of logits outlives rounding, which differs from place to place; a twist not.
        self._stride = 1 if twists else self._batch

    def act(self, observation: dict[str, Tensor], seeds: Tensor) -> Tensor:
        """Return the action of each row: of the greatest logit, or drawn at the temperature.

        Of a file that gives twists these, (N, 6), cut at the limits.
        """
        logits = self.logits(observation).to(seeds.device)
        if self.interface.output == TWIST:
            limits = self._limits.to(logits)
            return logits.clamp(-limits, limits)
        return choose(logits, seeds, self.interface.temperature)

    def logits(self, observation: dict[str, Tensor]) -> Tensor:
        """Return what the file gives, finite float32 (N, 13) or (N, 6), on the CPU."""
        keys = SEEN[self.observation]
        missing = [key for key in keys if key not in observation]
        if missing:
            raise RacinesError(
                f"{self.path}: needs {', '.join(missing)}: make the environment with "
                f"observation={self.observation!r}"
            )
        seen = {key: observation[key].cpu() for key in keys}
        count = len(seen[keys[0]])
        parts = [self._run(seen, start, count) for start in range(0, count, self._stride)]
        return torch.cat([torch.empty(0, OUTPUTS[self.interface.output]), *parts])

    def _run(self, seen: dict[str, Tensor], start: int, count: int) -> Tensor:
        # The last row again, not zeros: the graph need not bear an image that no probe makes.
        last = min(start + self._stride, count) - 1
        rows = torch.arange(start, start + self._batch).clamp_max(last)
        output, width = self.interface.output, OUTPUTS[self.interface.output]
        try:
            (logits,) = self._session.run(
                [output], {key: value[rows].numpy() for key, value in seen.items()}
            )
        except RacinesError:
            raise
        except Exception as error:
            raise RacinesError(f"{self.path}: onnxruntime failed: {error}") from error
        if logits.shape != (self._batch, width) or not np.isfinite(logits).all():
            raise RacinesError(
                f"{self.path}: {output} came with shape {logits.shape} for {self._batch} rows, or "
                f"not finite: give finite (B, {width})"
            )
        return torch.from_numpy(logits)[: last + 1 - start]

    @classmethod
    def load(cls, run_dir: Path, device: torch.device | str = "cpu") -> Self:
        """Open a file, or `policy.onnx` in a folder."""
        path = Path(run_dir)
        return cls(path / FILE if path.is_dir() else path, device)


class PolicyNetwork(nn.Module):
    """From what the environment shows to logits or a twist: encoder, if any, then the actor."""

    def __init__(self, agent: PolicyAgent) -> None:
        super().__init__()
        self.actor, self.encoder = agent.actor, agent.encoder
        self.names = SEEN[agent.observation]
        self.decide = agent.decide

    def forward(self, *inputs: Tensor) -> Tensor:
        """Return (B, 13) logits of `image` (B, 128, 128) uint8 and/or `params` (B, 9)."""
        seen = dict(zip(self.names, inputs, strict=True))
        return self.decide(actor_logits(self.actor, self.encoder, seen))


def export_policy(agent: Any, path: Path, about: dict[str, Any] | None = None) -> dict[str, Any]:
    """Write a trained policy as an ONNX file (see `read_policy`).

    Its card also says what `about` does. Returns path, size in bytes, opset, observation.

    Raises:
        RacinesError: the agent has no network, or the optional packages are missing.
    """
    if not isinstance(agent, PolicyAgent):
        name = getattr(agent, "name", type(agent).__name__)
        raise RacinesError(f"{name} has no network: it cannot be an ONNX file")
    if agent.remembers:
        raise RacinesError(
            f"{agent.name} remembers what it has seen: it cannot be an ONNX file; record a trace"
        )
    network = PolicyNetwork(agent)
    shapes = {
        IMAGE: torch.zeros(EXAMPLES, IMAGE_SIZE, IMAGE_SIZE, dtype=torch.uint8),
        PARAMS: torch.zeros(EXAMPLES, PARAMS_SIZE),
    }
    card = {
        "agent": agent.name,
        "view": agent.view,
        "observation": agent.observation,
        "encoder": agent.encoder.sha256 if agent.encoder is not None else None,
        "config": asdict(agent.config),
        "code": code_version(),
    }
    metadata = {
        "racines.schema": SCHEMA,
        "racines.name": agent.name,
        "racines.view": agent.view,
        "racines.temperature": json.dumps(getattr(agent.config, "temperature", 0.0)),
        "racines.card": json.dumps(card | (about or {})),
    }
    examples = {name: shapes[name] for name in network.names}
    output = TWIST if acts(agent) == VELOCITY else LOGITS
    written = write_onnx(network, examples, output, metadata, path)
    read_policy(path)
    return written | {"observation": agent.observation}


def export_run(run_dir: Path, path: Path) -> dict[str, Any]:
    """Export the policy that a training left in a folder; arguments and errors as above."""
    content = read_described(run_dir, "no trained policy: run `racines train agent NAME`")
    agent = agent_class(str(content.get("agent"))).load(run_dir)
    kept = run_dir / "metrics.json"
    metrics = json.loads(kept.read_text(encoding="utf-8")) if kept.is_file() else {}
    about = {key: metrics[key] for key in ("phantom", "data") if key in metrics}
    return export_policy(agent, path, about | {"seed": content.get("seed")})
