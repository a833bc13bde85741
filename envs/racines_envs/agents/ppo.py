"""Proximal policy optimisation (Schulman et al., 2017) with TorchRL; reads from top to bottom."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from torch import Tensor, nn

from racines_envs.agents.policy import make_network
from racines_envs.agents.training import LearningAgent, TrainingConfig, TrainingRun

if TYPE_CHECKING:
    from tensordict import TensorDictBase


@dataclass(frozen=True)
class PPOConfig(TrainingConfig):
    """Settings of a training; the defaults learn a view from the probe's pose on two CPU cores.

    Small updates made often learn from fewest environment steps.
    """

    epochs: int = 10
    """Passes over the steps of an update."""
    minibatch: int = 512
    """Steps of a gradient step."""
    clip: float = 0.2
    """Clip range of the probability ratio."""
    actor_lr: float = 1e-3
    critic_lr: float = 1e-3
    anneal: bool = True
    """Let both rates fall linearly to zero."""
    gae_lambda: float = 0.95
    """λ of the generalised advantage estimate."""
    entropy: float = 0.01
    """Weight of the entropy bonus."""


class _Training(TrainingRun):
    """One run: actor and critic, advantage and loss."""

    trained = ("actor", "critic", "optimiser")

    def _build(self) -> None:
        from tensordict.nn import TensorDictModule
        from torch.distributions import Categorical
        from torchrl.modules import ProbabilisticActor, ValueOperator
        from torchrl.objectives import ClipPPOLoss
        from torchrl.objectives.value import GAE

        super()._build()
        config, keys = self.config, list[Any](self.actor.keys)
        self.critic = make_network(config, self.encoder, 1, 1.0).to(config.device).eval()
        self.policy = ProbabilisticActor(
            TensorDictModule(self.actor, in_keys=keys, out_keys=["logits"]), in_keys=["logits"],
            distribution_class=Categorical, return_log_prob=True, spec=self.env.action_spec,
        )  # fmt: skip
        value = ValueOperator(self.critic, in_keys=keys)
        self.advantage = GAE(
            gamma=config.gamma, lmbda=config.gae_lambda, value_network=value, deactivate_vmap=True
        )
        self.loss = ClipPPOLoss(
            self.policy, value, clip_epsilon=config.clip, entropy_coeff=config.entropy,
            critic_coeff=1.0, loss_critic_type="smooth_l1", normalize_advantage=True,
            functional=False,
        )  # fmt: skip
        networks = (self.actor, config.actor_lr), (self.critic, config.critic_lr)
        groups = [{"params": [*network.parameters()], "lr": rate} for network, rate in networks]
        self.optimiser = torch.optim.Adam(groups, eps=1e-5)

    def _update(self, batch: "TensorDictBase") -> dict[str, float]:
        """Improve actor and critic by several passes over one batch."""
        config = self.config
        batch["next", "reward"] = batch["next", "reward"] * config.reward_scale
        with torch.no_grad():
            self.advantage(batch)
        flat = batch.reshape(-1).exclude("next", "collector", "info")
        if config.anneal:
            rate = max(0.0, 1.0 - self.frames / config.frames)
            for group, lr in zip(
                self.optimiser.param_groups, (config.actor_lr, config.critic_lr), strict=True
            ):
                group["lr"] = lr * rate
        sums: dict[str, Tensor] = {}
        count = 0
        for _ in range(config.epochs):
            order = torch.randperm(flat.shape[0], device=flat.device)
            for rows in order.split(config.minibatch):
                values = self.loss(flat[rows])
                total = values["loss_objective"] + values["loss_entropy"] + values["loss_critic"]
                self.optimiser.zero_grad()
                total.backward()
                nn.utils.clip_grad_norm_(self.loss.parameters(), config.max_gradient)
                self.optimiser.step()
                count += 1
                for key in ("loss_objective", "loss_critic", "entropy", "kl_approx"):
                    sums[key] = sums.get(key, 0.0) + values[key].detach().mean()
        self._refresh_norms(flat[torch.randperm(len(flat))[: config.minibatch]])
        return {f"update/{key}": float(value) / count for key, value in sums.items()}

    @torch.no_grad()
    def _refresh_norms(self, sample: "TensorDictBase") -> None:
        # Normalisation keeps its running statistics while acting and while learning, so that the
        # first probability ratio of an update is exactly one; they move between updates only.
        seen = [sample[key] for key in self.actor.keys]
        for network in (self.actor, self.critic):
            network.train()
            network(*seen)
            network.eval()


class PPOAgent(LearningAgent):
    """A trained policy; acts greedily."""

    name: ClassVar[str] = "ppo"
    Config: ClassVar[type] = PPOConfig
    Learner: ClassVar[type[TrainingRun]] = _Training
