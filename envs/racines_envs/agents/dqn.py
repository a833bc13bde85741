"""Deep Q-learning (Mnih et al., 2015; double: van Hasselt et al., 2016) with TorchRL."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from torch import Tensor, nn

from racines_data.errors import RacinesError
from racines_envs.agents.policy import PolicyAgent
from racines_envs.agents.settings import TrainingConfig
from racines_envs.agents.training import LearningAgent, TrainingRun

if TYPE_CHECKING:
    from tensordict import TensorDictBase


@dataclass(frozen=True)
class DQNConfig(TrainingConfig):
    """Settings of a training; the defaults learn a view from the probe's pose on two CPU cores."""

    frames: int = 200_000
    update_every: int = 512
    max_gradient: float = 10.0
    validate_every: int = 20_000
    updates: int = 32
    """Gradient steps after `update_every` environment steps."""
    batch_size: int = 256
    """Steps drawn from the replay buffer for a gradient step."""
    buffer: int = 100_000
    """Latest environment steps kept. A step of images takes 32 KiB: 100,000 are 3 GiB."""
    warmup: int = 5_000
    """Steps in the buffer before learning begins; a resumed run fills it again first."""
    learning_rate: float = 5e-4
    """Adam's."""
    soft_update: float = 0.01
    """Share of the way that the target network goes to the other at each gradient step."""
    explore_first: float = 1.0
    """Share of actions drawn at random at the beginning."""
    explore_last: float = 0.05
    """The same at the end."""
    explore_until: float = 0.4
    """Share of the frames over which it falls, linearly."""


class _Training(TrainingRun):
    """One run: action values and their target, the buffer, and what is left to chance."""

    trained = ("actor", "optimiser")

    def __init__(self, cls: type[PolicyAgent], config: DQNConfig, *where: Any) -> None:
        if not config.batch_size <= config.warmup <= config.buffer:
            raise RacinesError(
                f"agents.dqn: batch_size {config.batch_size}, warmup {config.warmup} and buffer "
                f"{config.buffer} must not fall"
            )
        super().__init__(cls, config, *where)

    def _build(self) -> None:
        from tensordict.nn import TensorDictSequential
        from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
        from torchrl.modules import EGreedyModule, QValueActor
        from torchrl.objectives import DQNLoss, SoftUpdate

        super()._build()
        config, keys = self.config, list[Any](self.actor.keys)
        value: Any = QValueActor(self.actor, in_keys=keys, action_space="categorical")
        self.explore: Any = EGreedyModule(self.env.action_spec).to(config.device)
        self.policy = TensorDictSequential(value, self.explore)
        self.loss = DQNLoss(
            value, loss_function="smooth_l1", delay_value=True, double_dqn=True,
            action_space="categorical",
        )  # fmt: skip
        self.loss.make_value_estimator(gamma=config.gamma)
        self.loss.eval()  # normalisation keeps its running statistics, as in PPO
        self.follow = SoftUpdate(self.loss, tau=config.soft_update)
        self.optimiser = torch.optim.Adam(self.actor.parameters(), lr=config.learning_rate)
        self.buffer = TensorDictReplayBuffer(
            storage=LazyTensorStorage(config.buffer, device=config.device),
            batch_size=config.batch_size,
        )
        self.kept = [*keys, "action", *(("next", key) for key in keys)]
        self.kept += [("next", key) for key in ("reward", "done", "terminated")]
        self._explore_at(0)

    def _explore_at(self, frames: int) -> None:
        """Set the share of random actions from a number of frames on."""
        config = self.config
        gone = min(1.0, frames / (config.explore_until * config.frames))
        share = config.explore_first + (config.explore_last - config.explore_first) * gone
        self.explore.eps.fill_(share)

    def _update(self, batch: "TensorDictBase") -> dict[str, float]:
        """Keep a batch, learn once enough is kept, and explore less from now on."""
        kept = batch.reshape(-1).select(*self.kept).clone()
        kept["next", "reward"] = kept["next", "reward"] * self.config.reward_scale
        self.buffer.extend(kept)
        figures = self._learn() if len(self.buffer) >= self.config.warmup else {}
        figures["update/exploration"] = float(self.explore.eps)
        self._explore_at(self.frames + batch.numel())
        return figures

    def _learn(self) -> dict[str, float]:
        """Learn from steps of the buffer, and let the target network follow."""
        config, total = self.config, torch.zeros((), device=self.config.device)
        self._refresh_norms()
        for _ in range(config.updates):
            loss = self.loss(self.buffer.sample())["loss"]
            self.optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(self.actor.parameters(), config.max_gradient)
            self.optimiser.step()
            self.follow.step()
            total = total + loss.detach()
        return {"update/loss": float(total) / config.updates}

    @torch.no_grad()
    def _refresh_norms(self) -> None:
        """Move the running statistics on, of both networks alike; they are still while learning."""
        sample = self.buffer.sample()
        self.actor.train()
        self.actor(*(sample[key] for key in self.actor.keys))
        self.actor.eval()
        for key, statistic in self.loss.value_network_params.items(True, True):
            if not statistic.requires_grad:
                self.loss.target_value_network_params[key].data.copy_(statistic.data)

    def _target(self) -> dict[str, Tensor]:
        items = self.loss.target_value_network_params.items(True, True)
        return {".".join(key) if isinstance(key, tuple) else key: value for key, value in items}

    def _state(self) -> dict[str, Any]:
        return super()._state() | {"target": {k: v.data.clone() for k, v in self._target().items()}}

    def _restore(self, state: dict[str, Any]) -> None:
        """Continue a run; the buffer is filled anew by the policy that was learned so far."""
        super()._restore(state)
        for name, value in self._target().items():
            value.data.copy_(state["target"][name])
        self._explore_at(self.frames)


class DQNAgent(LearningAgent):
    """A trained network of action values; takes the action of greatest value."""

    name: ClassVar[str] = "dqn"
    Config: ClassVar[type] = DQNConfig
    Learner: ClassVar[type[TrainingRun]] = _Training
