"""Policies that were learned: acting greedily, and the files of a run."""

from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, Self

import torch
from torch import Tensor, nn

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.files import write_json
from racines_data.randomness import uniform
from racines_envs.agents.networks import ObservationNetwork, PoseEncoder, open_encoder
from racines_envs.robots.arm import FREE
from racines_envs.task.actions import ACTIONS
from racines_envs.task.core import ScanCore
from racines_envs.task.names import HEART_TIER, tier_of
from racines_models.devices import resolve_device
from racines_models.networks.batching import in_fixed_batches
from racines_models.weights import load_network, read_described, save_weights

POLICY = "policy.safetensors"
_DRAWS = 23


def told_settings(config: Any) -> dict[str, Any]:
    """Return a training's settings as they are written down; one heart has no patients to tell."""
    later = ("patients",) if tier_of(config.view) == HEART_TIER else ()
    return {name: value for name, value in arms_told(config).items() if name not in later}


def arms_told(config: Any) -> dict[str, Any]:
    """Return settings with their `robot` if it is an arm.

    A free probe is not told: settings without one are those from before there were arms.
    """
    return {k: v for k, v in asdict(config).items() if (k, v) != ("robot", FREE)}


def make_network(
    config: Any, encoder: nn.Module | None, outputs: int, gain: float
) -> ObservationNetwork:
    """Return an untrained network of the config's `observation`, `hidden` and `rotation`."""
    features: Any = encoder.size if encoder is not None else 0
    rotation, looks = getattr(config, "rotation", "continuous"), getattr(encoder, "looks", 0)
    shape: Any = (config.observation, outputs, config.hidden, gain, features, rotation, looks)
    return ObservationNetwork(*shape)


def make_actor(
    config: Any, encoder: nn.Module | None = None, outputs: int = len(ACTIONS)
) -> ObservationNetwork:
    """Return an untrained actor, near uniform."""
    return make_network(config, encoder, outputs, 0.01)


def actor_logits(
    actor: ObservationNetwork, encoder: nn.Module | None, seen: dict[str, Tensor]
) -> Tensor:
    """Return the (N, 13) scores of the actions where `image` (N, 128, 128) and so on are seen.

    The encoder, if there is one, makes `features` of the image, unless they are there.
    """
    if encoder is not None and "image" in seen and "features" not in seen:
        seen = seen | {"features": encoder(seen["image"])}
    elif "image" in seen:
        seen = seen | {"image": seen["image"].unsqueeze(1)}
    return actor(*(seen[key] for key in actor.keys))


def choose(logits: Tensor, seeds: Tensor, temperature: float) -> Tensor:
    """Return (N,) actions of (N, 13) logits: the greatest, or drawn from the (N,) seeds.

    At a temperature above 0 they follow softmax(logits / temperature), by the Gumbel-max trick.
    """
    if temperature > 0:
        drawn = uniform(seeds, logits.shape[1], _DRAWS).clamp_min(1e-12).to(logits.device)
        logits = logits / temperature - (-drawn.log()).log()
    return logits.argmax(-1)


class PolicyAgent:
    """An agent with an actor network; a subclass adds `name`, `Config` and `train`."""

    name: ClassVar[str]
    Config: ClassVar[type]
    outputs: ClassVar[int] = len(ACTIONS)
    """Numbers that its network gives."""
    hashed: ClassVar[str] = "encoder_sha256"
    """Where a run's `config.json` names the weights of what it looks through."""
    remembers: ClassVar[bool] = False
    """Whether what it does in a step depends on the steps before; see `rollout`."""

    def __init_subclass__(cls, **options: Any) -> None:
        """Take a subclass that wants to meet the environment for one that keeps a memory."""
        super().__init_subclass__(**options)
        if "attach" in vars(cls) and "remembers" not in vars(cls):
            cls.remembers = True

    def __init__(
        self, config: Any, actor: ObservationNetwork, encoder: PoseEncoder | None = None
    ) -> None:
        """Wrap an actor; the config has `view`, `observation`, `hidden` and `encoder`."""
        self.config, self.actor, self.encoder = config, actor, encoder
        self.observation: str = config.observation
        self.view: str = config.view

    def attach(self, core: ScanCore) -> None:
        """Keep nothing of the environment."""

    @torch.no_grad()
    def act(self, observation: dict[str, Tensor], seeds: Tensor) -> Tensor:
        """Return the most probable action of each row, or drawn ones at a `temperature`."""
        was_training = self.actor.training
        self.actor.eval()
        allowed = observation.get("action_mask")
        seen = {key: value for key, value in observation.items() if key != "action_mask"}
        keys, columns = zip(*seen.items(), strict=True)
        logits = in_fixed_batches(
            lambda *seen: self.logits(dict(zip(keys, seen, strict=True))), *columns
        )
        self.actor.train(was_training)
        if allowed is not None:
            logits = logits.masked_fill(~allowed.to(logits.device), -torch.inf)
        return choose(logits, seeds, getattr(self.config, "temperature", 0.0))

    def logits(self, observation: dict[str, Tensor]) -> Tensor:
        """Return the (N, 13) scores of the actions, or whatever else the network gives.

        Differentiable with respect to `image` (N, 128, 128), 0-255, where it is float.
        """
        device = next(self.actor.parameters()).device
        seen = {name: value.to(device) for name, value in observation.items()}
        return actor_logits(self.actor, self.encoder, seen)

    def decide(self, outputs: Tensor) -> Tensor:
        """Return what an ONNX file of it gives of the network's outputs: logits, as they are."""
        return outputs

    @classmethod
    def opened(cls, config: Any, run_dir: Path, sha256: str, device: Any) -> Any:
        """Return what a saved policy looks through, of a hash; None if it learned to see."""
        return open_encoder(getattr(config, "encoder", ""), device, run_dir, sha256)

    def save(self, run_dir: Path, metrics: dict[str, Any], seed: int) -> None:
        """Write policy.safetensors, config.json and metrics.json."""
        save_weights(run_dir / POLICY, self.actor.state_dict())
        config = {"agent": self.name, "config": told_settings(self.config), "seed": seed}
        if self.encoder is not None:
            config[self.hashed] = self.encoder.sha256
        write_json(run_dir / "config.json", config)
        write_json(run_dir / "metrics.json", metrics)

    @classmethod
    def load(cls, run_dir: Path, device: torch.device | str = "cpu") -> Self:
        """Read a saved policy; one of another agent or shape is refused."""
        device, remedy = resolve_device(device), f"run `racines train agent {cls.name}`"
        policy, described = Path(run_dir) / POLICY, Path(run_dir) / "config.json"
        if not policy.is_file():
            raise RacinesError(f"{run_dir}: no trained policy: {remedy}")
        content = read_described(Path(run_dir), f"no trained policy: {remedy}")
        if content.get("agent") != cls.name:
            raise RacinesError(f"{described}: a policy of {content.get('agent')!r}, not {cls.name}")
        config = fill(cls.Config, content["config"], str(described))
        encoder = cls.opened(config, Path(run_dir), str(content.get(cls.hashed)), device)
        actor = make_actor(config, encoder, cls.outputs)
        load_network(policy, actor, remedy)
        return cls(config, actor.to(device).eval(), encoder)
