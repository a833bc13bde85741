"""Soft actor-critic (Haarnoja et al., 2018; tuned temperature: 2019) with TorchRL.

The baseline of continuous actions: it commands a twist of the probe (`action="velocity"`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from torch import Tensor, nn

from racines_data.errors import RacinesError
from racines_envs.agents.networks import ObservationNetwork, PoseEncoder
from racines_envs.agents.policy import PolicyAgent, make_network
from racines_envs.agents.settings import TrainingConfig
from racines_envs.agents.training import LearningAgent, TrainingRun
from racines_envs.task.motion import VELOCITY, Velocity
from racines_envs.worlds.making import find_task
from racines_models.networks.batching import in_fixed_batches

if TYPE_CHECKING:
    from tensordict import TensorDictBase

AXES = 6


@dataclass(frozen=True)
class SACConfig(TrainingConfig):
    """Settings of a training; the defaults learn a view from the probe's pose on two CPU cores."""

    frames: int = 120_000
    update_every: int = 512
    max_gradient: float = 10.0
    validate_every: int = 20_000
    updates: int = 32
    """Gradient steps after `update_every` environment steps."""
    batch_size: int = 256
    """Steps drawn from the replay buffer for a gradient step."""
    buffer: int = 200_000
    """Latest environment steps kept."""
    warmup: int = 5_000
    """Steps in the buffer before learning begins; a resumed run fills it again first."""
    learning_rate: float = 5e-4
    """Adam's, of actor, critics and temperature."""
    soft_update: float = 0.01
    """Share of the way that the target critics go to the others at each gradient step."""
    first_temperature: float = 0.02
    """Worth of entropy at the beginning, in rewards as they are scaled for learning."""
    entropy: float = -AXES
    """Entropy of a twist, in shares of its limits, that the temperature holds."""


class _Value(nn.Module):
    """What a twist is worth where it is taken: one number of what is seen and of six shares."""

    def __init__(self, seen: ObservationNetwork, limits: Tensor, hidden: Sequence[int]) -> None:
        super().__init__()
        self.seen, width = seen, hidden[-1]
        self.limits: Tensor
        self.register_buffer("limits", limits)
        self.head = nn.Sequential(
            nn.Linear(width + AXES, width), nn.Tanh(), nn.Linear(width, width), nn.Tanh(),
            nn.Linear(width, 1),
        )  # fmt: skip

    def forward(self, *seen_and_action: Tensor) -> Tensor:
        *seen, action = seen_and_action
        return self.head(torch.cat([self.seen(*seen).tanh(), action / self.limits], -1))


class _Training(TrainingRun):
    """One run: actor, two critics and their targets, the temperature, and the buffer."""

    trained = ("actor", "loss", "optimiser")

    def __init__(self, cls: type[PolicyAgent], config: SACConfig, *where: Any) -> None:
        if not config.batch_size <= config.warmup <= config.buffer:
            raise RacinesError(
                f"agents.sac: batch_size {config.batch_size}, warmup {config.warmup} and buffer "
                f"{config.buffer} must not fall"
            )
        if config.observation != "params" and not config.encoder:
            raise RacinesError(
                "agents.sac.encoder: it does not learn to see from reward: name an encoder, e.g. "
                "`explored`, or observe `params`"
            )
        super().__init__(cls, config, *where)
        self.where["action"] = VELOCITY

    def _build(self) -> None:
        from tensordict.nn import NormalParamExtractor, TensorDictModule
        from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
        from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
        from torchrl.objectives import SACLoss, SoftUpdate

        super()._build()
        config, keys, spec = self.config, list[Any](self.actor.keys), self.env.action_spec
        motion: Any = self.env.core.motion
        limits = motion.limits
        body = nn.Sequential(self.actor, NormalParamExtractor())
        self.policy: Any = ProbabilisticActor(
            TensorDictModule(body, in_keys=keys, out_keys=["loc", "scale"]),
            in_keys=["loc", "scale"], spec=spec, distribution_class=TanhNormal,
            distribution_kwargs={"low": -limits, "high": limits}, return_log_prob=False,
        )  # fmt: skip
        seen = make_network(config, self.encoder, config.hidden[-1], 1.0)
        value: Any = _Value(seen, limits, config.hidden).to(config.device).eval()
        self.loss = SACLoss(
            self.policy, ValueOperator(value, in_keys=[*keys, "action"]), action_spec=spec,
            target_entropy=config.entropy + float(limits.log().sum()),
            alpha_init=config.first_temperature,
        )  # fmt: skip
        self.loss.make_value_estimator(gamma=config.gamma)
        self.loss.eval()  # normalisation keeps its running statistics, as in PPO
        self.follow = SoftUpdate(self.loss, tau=config.soft_update)
        self.optimiser = torch.optim.Adam(self.loss.parameters(), lr=config.learning_rate)
        self.buffer = TensorDictReplayBuffer(
            storage=LazyTensorStorage(config.buffer, device=config.device),
            batch_size=config.batch_size,
        )
        self.kept = [*keys, "action", *(("next", key) for key in keys)]
        self.kept += [("next", key) for key in ("reward", "done", "terminated")]

    def _update(self, batch: "TensorDictBase") -> dict[str, float]:
        """Keep a batch, and learn once enough is kept."""
        kept = batch.reshape(-1).select(*self.kept).clone()
        kept["next", "reward"] = kept["next", "reward"] * self.config.reward_scale
        self.buffer.extend(kept)
        return self._learn() if len(self.buffer) >= self.config.warmup else {}

    def _learn(self) -> dict[str, float]:
        """Learn from steps of the buffer, and let the target critics follow."""
        config, names = self.config, ("loss_actor", "loss_qvalue", "loss_alpha")
        total = torch.zeros(len(names), device=config.device)
        found: dict[str, Tensor] = {}
        self._refresh_norms()
        for _ in range(config.updates):
            found = dict(self.loss(self.buffer.sample()).items())
            losses = torch.stack([found[name] for name in names])
            self.optimiser.zero_grad()
            losses.sum().backward()
            nn.utils.clip_grad_norm_(self.loss.parameters(), config.max_gradient)
            self.optimiser.step()
            self.follow.step()
            total = total + losses.detach()
        means = (total / config.updates).tolist()
        figures = {f"update/{name}": mean for name, mean in zip(names, means, strict=True)}
        return figures | {"update/temperature": float(found.get("alpha", 0.0))}

    @torch.no_grad()
    def _refresh_norms(self) -> None:
        """Move the running statistics on, of all networks alike; they are still while learning."""
        sample = self.buffer.sample()
        self.actor.train()
        self.actor(*(sample[key] for key in self.actor.keys))
        self.actor.eval()
        own = dict(self.actor.named_buffers())
        for critics in (self.loss.qvalue_network_params, self.loss.target_qvalue_network_params):
            for key, statistic in critics.items(True, True):
                name = ".".join(key).rpartition("seen.")[2] if isinstance(key, tuple) else key
                if name in own:
                    statistic.data.copy_(own[name].expand_as(statistic))


class SACAgent(LearningAgent):
    """A trained policy of twists; takes the middle of what it would draw."""

    name: ClassVar[str] = "sac"
    Config: ClassVar[type] = SACConfig
    Learner: ClassVar[type[TrainingRun]] = _Training
    outputs: ClassVar[int] = 2 * AXES
    action: ClassVar[str] = VELOCITY

    def __init__(
        self, config: Any, actor: ObservationNetwork, encoder: PoseEncoder | None = None
    ) -> None:
        """Wrap an actor, whose first six outputs are the twist before it is squashed."""
        super().__init__(config, actor, encoder)
        self._limits = Velocity(find_task(config.view), "cpu").limits

    @torch.no_grad()
    def act(self, observation: dict[str, Tensor], seeds: Tensor) -> Tensor:
        """Return (N, 6) twists, m/s and rad/s."""
        was_training = self.actor.training
        self.actor.eval()
        keys, columns = zip(*observation.items(), strict=True)
        outputs = in_fixed_batches(
            lambda *seen: self.logits(dict(zip(keys, seen, strict=True))), *columns
        )
        self.actor.train(was_training)
        return self.decide(outputs)

    def decide(self, outputs: Tensor) -> Tensor:
        """Return the (N, 6) twist of (N, 12) outputs."""
        return outputs[:, :AXES].tanh() * self._limits.to(outputs)
