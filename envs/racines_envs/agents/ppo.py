"""Proximal policy optimisation (Schulman et al., 2017) with TorchRL; reads from top to bottom."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from torch import Tensor, nn

from racines_envs.agents.graphs import replayed, set_rate
from racines_envs.agents.policy import make_network
from racines_envs.agents.settings import TrainingConfig
from racines_envs.agents.training import LearningAgent, TrainingRun

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
    cuda_graph: bool = True
    """On CUDA, replay a gradient step as one graph (see `graphs.py`); without effect on a CPU."""


TOLD = ("loss_objective", "loss_critic", "entropy", "kl_approx")
"""Figures of a gradient step, for the curves."""


class PPOTraining(TrainingRun):
    """One run: actor and critic, advantage and loss."""

    trained = ("actor", "critic", "optimiser")

    def _build(self) -> None:
        from tensordict.nn import TensorDictModule
        from torch.distributions import Categorical
        from torchrl.modules import ProbabilisticActor, ValueOperator
        from torchrl.objectives.value import GAE

        super()._build()
        config, keys = self.config, list[Any](self.actor.keys)
        self.graphed = config.cuda_graph and config.device.startswith("cuda")
        self.critic = make_network(config, self.encoder, 1, 1.0).to(config.device).eval()
        self.policy = ProbabilisticActor(
            TensorDictModule(self.actor, in_keys=keys, out_keys=["logits"]), in_keys=["logits"],
            distribution_class=Categorical, return_log_prob=True, spec=self.env.action_spec,
            distribution_kwargs={"validate_args": not self.graphed},
        )  # fmt: skip
        value = ValueOperator(self.critic, in_keys=keys)
        self.advantage = GAE(
            gamma=config.gamma, lmbda=config.gae_lambda, value_network=value, deactivate_vmap=True
        )
        self.loss = _loss_class()(
            self.policy, value, clip_epsilon=config.clip, entropy_coeff=config.entropy,
            critic_coeff=1.0, loss_critic_type="smooth_l1", normalize_advantage=True,
            functional=False,
        )  # fmt: skip
        networks = (self.actor, config.actor_lr), (self.critic, config.critic_lr)
        groups = [{"params": [*network.parameters()], "lr": rate} for network, rate in networks]
        self.optimiser = torch.optim.Adam(groups, eps=1e-5, capturable=self.graphed)
        place = config.device if self.graphed else "cpu"
        self.rates = [rate for _, rate in networks]
        self._set_rates(1.0)
        self.descend = replayed(self._descend, config.minibatch, place)

    def _set_rates(self, share: float) -> None:
        place = self.config.device if self.graphed else "cpu"
        for group, rate in zip(self.optimiser.param_groups, self.rates, strict=True):
            set_rate(group, rate * share, place)

    def _descend(self, batch: "TensorDictBase") -> "TensorDictBase":
        """Take one gradient step on a minibatch; return its figures."""
        from tensordict import TensorDict

        values = self.loss(batch)
        total = values["loss_objective"] + values["loss_entropy"] + values["loss_critic"]
        self.optimiser.zero_grad()
        total.backward()
        nn.utils.clip_grad_norm_(self.loss.parameters(), self.config.max_gradient)
        self.optimiser.step()
        return TensorDict({key: values[key].detach().mean() for key in TOLD})

    def _update(self, batch: "TensorDictBase") -> dict[str, float]:
        """Improve actor and critic by several passes over one batch."""
        config = self.config
        batch["next", "reward"] = batch["next", "reward"] * config.reward_scale
        with torch.no_grad():
            self.advantage(batch)
        flat = batch.reshape(-1).exclude("next", "collector", "info")
        if config.anneal or self.graphed:  # a restored optimiser's rates are no captured ones
            left = max(0.0, 1.0 - self.frames / config.frames)
            self._set_rates(left if config.anneal else 1.0)
        sums: dict[str, Tensor] = {}
        count = 0
        for _ in range(config.epochs):
            order = torch.randperm(len(flat), device=flat["action"].device)
            for rows in order.split(config.minibatch):
                told = self.descend(flat[rows])
                count += 1
                for key in TOLD:
                    sums[key] = sums[key] + told[key] if key in sums else told[key]
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


def _loss_class() -> Any:
    """Return TorchRL's loss, without its wait for the device in each step."""
    from torchrl.objectives import ClipPPOLoss

    class Loss(ClipPPOLoss):
        def _get_entropy(self, dist: Any, adv_shape: Any) -> Tensor:
            # A categorical distribution's entropy is known and finite; the base class looks whether
            # it is, on the host.
            return dist.entropy().unsqueeze(-1)

    return Loss


class PPOAgent(LearningAgent):
    """A trained policy; acts greedily."""

    name: ClassVar[str] = "ppo"
    Config: ClassVar[type] = PPOConfig
    Learner: ClassVar[type[TrainingRun]] = PPOTraining
