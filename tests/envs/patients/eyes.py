"""A servo that learned nothing, to see through, and notes of what it might have seen."""

import json
from dataclasses import asdict
from pathlib import Path

import torch

from racines_data.views import VIEWS
from racines_envs.agents.servo.learner import ServoConfig
from racines_models.networks.recall import TOKEN
from racines_models.networks.servo import ServoNetwork
from racines_models.weights import save_weights


def save(folder: Path, seed: int, drawn: int | None = None) -> None:
    torch.manual_seed(seed if drawn is None else drawn)
    folder.mkdir(parents=True, exist_ok=True)
    save_weights(folder / "policy.safetensors", ServoNetwork(len(VIEWS)).state_dict())
    told = {"agent": "servo", "config": asdict(ServoConfig()), "seed": seed}
    (folder / "config.json").write_text(json.dumps(told))
    (folder / "metrics.json").write_text("{}")


def some(count: int, length: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return tokens, of which the last few are not there, and labels."""
    draw = torch.Generator().manual_seed(seed)
    tokens = torch.randn(count, length, TOKEN, generator=draw)
    ends = torch.randint(length // 2, length, (count, 1), generator=draw)
    return tokens, torch.arange(length) < ends, torch.arange(count) % len(VIEWS)
