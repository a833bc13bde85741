"""A trained policy as one ONNX file: weights and frozen encoder inside, card in its metadata."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE
from racines_envs.agents.networks import SEEN
from racines_envs.agents.onnx.policy import IMAGE, OUTPUT, PARAMS, SCHEMA, read_policy
from racines_envs.agents.policy import PolicyAgent, actor_logits
from racines_envs.agents.protocol import agent_class
from racines_envs.task.core import PARAMS_SIZE
from racines_models.exchange.onnx.export import EXAMPLES, write_onnx
from racines_models.provenance import code_version
from racines_models.weights import read_described


class PolicyNetwork(nn.Module):
    """From what the environment shows to logits: the encoder, if there is one, then the actor."""

    def __init__(self, agent: PolicyAgent) -> None:
        super().__init__()
        self.actor, self.encoder = agent.actor, agent.encoder
        self.names = SEEN[agent.observation]

    def forward(self, *inputs: Tensor) -> Tensor:
        """Return (B, 13) logits of `image` (B, 128, 128) uint8 and/or `params` (B, 9)."""
        return actor_logits(self.actor, self.encoder, dict(zip(self.names, inputs, strict=True)))


def export_policy(agent: Any, path: Path, about: dict[str, Any] | None = None) -> dict[str, Any]:
    """Write a trained policy as an ONNX file (interface: see `read_policy`).

    Its card also says what `about` does. Returns path, size in bytes, opset, observation.

    Raises:
        RacinesError: the agent has no network, or the optional packages are missing.
    """
    if not isinstance(agent, PolicyAgent):
        name = getattr(agent, "name", type(agent).__name__)
        raise RacinesError(f"{name} has no network: it cannot be an ONNX file")
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
    written = write_onnx(network, examples, OUTPUT, metadata, path)
    read_policy(path)
    return written | {"observation": agent.observation}


def export_run(run_dir: Path, path: Path) -> dict[str, Any]:
    """Export the policy that a training left in a folder; arguments and errors as above."""
    content = read_described(run_dir, "no trained policy: run `racines train agent NAME`")
    agent = agent_class(str(content.get("agent"))).load(run_dir)
    kept = run_dir / "metrics.json"
    metrics = json.loads(kept.read_text()) if kept.is_file() else {}
    about = {key: metrics[key] for key in ("phantom", "data") if key in metrics}
    return export_policy(agent, path, about | {"seed": content.get("seed")})
