"""Policies that were learned: acting greedily, and the files of a run."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, Self

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_envs.actions import ACTIONS
from racines_envs.agents.networks import KEYS, ObservationNetwork
from racines_envs.core import ScanCore

POLICY = "policy.safetensors"


def make_actor(config: Any) -> ObservationNetwork:
    """Return an untrained actor of the config's `observation` and `hidden`, near uniform."""
    return ObservationNetwork(config.observation, len(ACTIONS), config.hidden, gain=0.01)


class PolicyAgent:
    """An agent with an actor network; a subclass adds `name`, `Config` and `train`."""

    name: ClassVar[str]
    Config: ClassVar[type]

    def __init__(self, config: Any, actor: ObservationNetwork) -> None:
        """Wrap an actor; the config has `view`, `observation` and `hidden`."""
        self.config, self.actor = config, actor
        self.observation: str = config.observation
        self.view: str = config.view

    def attach(self, core: ScanCore) -> None:
        """Keep nothing of the environment."""

    @torch.no_grad()
    def act(self, observation: dict[str, Tensor], seeds: Tensor) -> Tensor:
        """Return the most probable action of each row."""
        was_training, device = self.actor.training, next(self.actor.parameters()).device
        self.actor.eval()
        seen = [observation[key].to(device) for key in KEYS[self.observation]]
        if self.observation != "params":
            seen[0] = seen[0].unsqueeze(1)
        action = self.actor(*seen).argmax(-1)
        self.actor.train(was_training)
        return action

    def save(self, run_dir: Path, metrics: dict[str, Any], seed: int) -> None:
        """Write policy.safetensors, config.json and metrics.json."""
        from safetensors.torch import save

        from racines_data.files import write_atomic, write_json

        state = {k: v.detach().cpu().contiguous() for k, v in self.actor.state_dict().items()}
        write_atomic(run_dir / POLICY, save(state))
        config = {"agent": self.name, "config": asdict(self.config), "seed": seed}
        write_json(run_dir / "config.json", config)
        write_json(run_dir / "metrics.json", metrics)

    @classmethod
    def load(cls, run_dir: Path, device: torch.device | str = "cpu") -> Self:
        """Read a saved policy.

        Raises:
            RacinesError: no policy in the folder, or one of another agent or shape.
        """
        from safetensors import SafetensorError
        from safetensors.torch import load_file

        from racines_data.config import fill

        policy, described = Path(run_dir) / POLICY, Path(run_dir) / "config.json"
        if not policy.is_file() or not described.is_file():
            raise RacinesError(
                f"{run_dir}: no trained policy: run `racines train agent {cls.name}`"
            )
        content = json.loads(described.read_text())
        if content.get("agent") != cls.name:
            raise RacinesError(f"{described}: a policy of {content.get('agent')!r}, not {cls.name}")
        config = fill(cls.Config, content["config"], str(described))
        actor = make_actor(config)
        try:
            actor.load_state_dict(load_file(policy))
        except (RuntimeError, SafetensorError) as error:
            raise RacinesError(f"{policy}: does not fit {described}: {error}") from error
        return cls(config, actor.to(device).eval())
