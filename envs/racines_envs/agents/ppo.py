"""Proximal policy optimisation (Schulman et al., 2017) with TorchRL; reads from top to bottom."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn

from racines_envs.agents.networks import ObservationNetwork
from racines_envs.agents.policy import PolicyAgent, make_actor
from racines_envs.agents.training.config import TrainingConfig
from racines_envs.agents.training.run import TrainingRun
from racines_envs.worlds.backends import JudgeLike
from racines_envs.worlds.making import WorldLike


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


class PPOAgent(PolicyAgent):
    """A trained policy; acts greedily."""

    name: ClassVar[str] = "ppo"
    Config: ClassVar[type] = PPOConfig

    @classmethod
    def train(
        cls,
        config: PPOConfig,
        run_dir: Path,
        *,
        seed: int = 0,
        phantom: WorldLike = None,
        grader: JudgeLike = None,
        data: Path | str | None = None,
        resume: bool | None = None,
        progress: bool = True,
        **where: Any,
    ) -> "PPOAgent":
        """Train and save the policy that validated best.

        Args:
            config: The settings.
            run_dir: Receives policy, metrics and curves, and checkpoints while it trains.
            seed: Of weights, episodes and draws.
            phantom: A phantom or its configuration; the shared default by default.
            grader: For the reward `paper`, instead of the folder in the settings.
            data: Folder of the dataset, for the backend `replay`; data/racines by default.
            resume: True: go on from the last checkpoint, which must be there; False: start anew;
                None: go on if there is a checkpoint of this very run.
            progress: Print a line a validation.
            where: Taken for the protocol's sake; nothing more is known.

        Raises:
            RacinesError: settings that do not fit together, or a checkpoint of another run.
        """
        run = _Training(cls, config, Path(run_dir), seed, phantom, grader, progress, data)
        return run.run(resume)


class _Training(TrainingRun):
    """One run: environment, networks, loss, and the loop."""

    trained = ("actor", "critic", "optimiser")

    def _build(self) -> None:
        from torch.distributions import Categorical
        from torchrl.modules import ProbabilisticActor, ValueOperator
        from torchrl.objectives import ClipPPOLoss
        from torchrl.objectives.value import GAE

        from racines_envs.apis.torchrl_env import ScanEnv

        config = self.config
        self.env = ScanEnv(config.view, config.envs, **self.where)
        self.actor = make_actor(config, self.encoder).to(config.device).eval()
        features = self.encoder.size if self.encoder is not None else 0
        self.critic = ObservationNetwork(
            config.observation, 1, config.hidden, 1.0, features, config.rotation
        )
        keys: list[Any] = self.actor.keys
        self.critic.to(config.device).eval()
        self.policy = ProbabilisticActor(
            TensorDictModule(self.actor, in_keys=keys, out_keys=["logits"]),
            in_keys=["logits"],
            distribution_class=Categorical,
            return_log_prob=True,
            spec=self.env.action_spec,
        )
        value = ValueOperator(self.critic, in_keys=keys)
        self.advantage = GAE(
            gamma=config.gamma, lmbda=config.gae_lambda, value_network=value, deactivate_vmap=True
        )
        self.loss = ClipPPOLoss(
            self.policy,
            value,
            clip_epsilon=config.clip,
            entropy_coeff=config.entropy,
            critic_coeff=1.0,
            loss_critic_type="smooth_l1",
            normalize_advantage=True,
            functional=False,
        )
        self.optimiser = torch.optim.Adam(
            [
                {"params": list(self.actor.parameters()), "lr": config.actor_lr},
                {"params": list(self.critic.parameters()), "lr": config.critic_lr},
            ],
            eps=1e-5,
        )
        self.agent = PPOAgent(config, self.actor, self.encoder)

    def _loop(self, live: Any) -> None:
        from torchrl.collectors import Collector

        config = self.config
        self.env.set_seed(self.seed * 1_000_003 + self.frames)
        left = -(-(config.frames - self.frames) // config.update_every)
        collector = Collector(
            self.env,
            self.policy,
            frames_per_batch=config.update_every,
            total_frames=left * config.update_every,
        )
        for batch in collector:
            self._count(batch, self._update(batch), live)
        collector.shutdown()

    def _update(self, batch: TensorDictBase) -> dict[str, float]:
        """Improve actor and critic on one batch (envs, steps) of experience."""
        config = self.config
        reward = batch["next", "reward"]
        batch["next", "reward"] = reward * config.reward_scale
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
    def _refresh_norms(self, sample: TensorDictBase) -> None:
        # Normalisation keeps its running statistics while acting and while learning, so that the
        # first probability ratio of an update is exactly one; they move between updates only.
        seen = [sample[key] for key in self.actor.keys]
        for network in (self.actor, self.critic):
            network.train()
            network(*seen)
            network.eval()
