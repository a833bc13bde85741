"""Proximal policy optimisation (Schulman et al., 2017) with TorchRL; reads from top to bottom."""

import time
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn

from racines_data.errors import RacinesError
from racines_envs.agents.encoders import open_encoder
from racines_envs.agents.networks import ObservationNetwork
from racines_envs.agents.policy import PolicyAgent, make_actor
from racines_envs.making import find_task, make_core, make_phantom, phantom_recipe
from racines_envs.rewards import RewardConfig
from racines_envs.rollout import rollout
from racines_envs.starts import validation_seeds
from racines_models.training.checkpoint import Checkpoint, discard_checkpoint


@dataclass(frozen=True)
class PPOConfig:
    """Settings of a training; the defaults learn a view from the probe's pose on two CPU cores."""

    view: str = "SC"
    """The target view."""
    observation: str = "params"
    """`image`, `params` or `multimodal`."""
    encoder: str = ""
    """What looks at the image: `pose` (the published pose regressor, frozen), a folder of another,
    or "" for convolutions that learn from reward alone, as in the paper."""
    reward: str = "shaped"
    """`paper` (needs a grader), `oracle` or `shaped`."""
    backend: str = "phantom"
    """`phantom` or `generator`; nothing is drawn where nothing looks."""
    generator: str = ""
    """Name or run folder, for the backend `generator`."""
    grader: str = ""
    """Run folder, for the reward `paper`; models/runs/grader if empty."""
    frames: int = 300_000
    """Environment steps in all; rounded up to whole updates."""
    envs: int = 256
    """Environments side by side."""
    update_every: int = 8_192
    """Environment steps between updates, a multiple of `envs`."""
    epochs: int = 5
    """Passes over the steps of an update."""
    minibatch: int = 2_048
    clip: float = 0.2
    """Clip range of the probability ratio."""
    actor_lr: float = 1e-3
    critic_lr: float = 1e-3
    anneal: bool = True
    """Let both rates fall linearly to zero."""
    gamma: float = 0.97
    """Discount."""
    gae_lambda: float = 0.95
    """λ of the generalised advantage estimate."""
    entropy: float = 0.01
    """Weight of the entropy bonus."""
    reward_scale: float = 0.05
    """Multiplies rewards before learning; reports stay unscaled."""
    max_gradient: float = 0.5
    """Gradient norm at which to clip."""
    hidden: tuple[int, ...] = (128, 128)
    """Widths of the dense layers."""
    validate_every: int = 50_000
    """Environment steps between validations; also between checkpoints."""
    validation_starts: int = 100
    """Episodes a validation, from starts that no evaluation uses."""
    threads: int = 1
    """CPU threads; small networks are fastest with one. 0 leaves torch as it is."""
    device: str = "cpu"


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
        phantom: Any = None,
        grader: Any = None,
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
            resume: True: go on from the last checkpoint, which must be there; False: start anew;
                None: go on if there is a checkpoint of this very run.
            progress: Print a line a validation.
            where: Taken for the protocol's sake; nothing more is known.

        Raises:
            RacinesError: settings that do not fit together, or a checkpoint of another run.
        """
        return _Training(config, Path(run_dir), seed, phantom, grader, progress).run(resume)


class _Training:
    """One run: environment, networks, loss, and the loop."""

    def __init__(
        self, config: PPOConfig, folder: Path, seed: int, phantom: Any, grader: Any, progress: bool
    ) -> None:
        if config.update_every % config.envs:
            raise RacinesError(
                f"agents.ppo.update_every is {config.update_every}: give a multiple of envs "
                f"({config.envs})"
            )
        self.config, self.folder, self.seed, self.progress = config, folder, seed, progress
        anatomy = find_task(config.view, phantom).anatomy
        looks = config.observation != "params"
        self.encoder = open_encoder(config.encoder, config.device) if looks else None
        self.where = {
            "encoder": self.encoder,
            "backend": config.backend,
            "observation": config.observation,
            "reward": config.reward,
            "generator": config.generator or None,
            "grader": grader or config.grader or None,
            "rewards": RewardConfig(discount=config.gamma),
            "phantom": make_phantom(phantom, config.device, anatomy),
            "device": config.device,
        }
        self.frames, self.best, self.history = 0, (-1.0, 0.0), []
        self.seconds = 0.0
        identity = {"agent": "ppo", "seed": seed, **asdict(config), "hidden": list(config.hidden)}
        identity |= {
            "encoder_sha256": self.encoder.sha256 if self.encoder is not None else None,
            "phantom": phantom_recipe(self.where["phantom"]),
        }
        self.checkpoint = Checkpoint(folder, identity)

    def run(self, resume: bool | None) -> PPOAgent:
        """Collect, update, validate, checkpoint, until all frames are seen."""
        threads = torch.get_num_threads()
        torch.set_num_threads(self.config.threads or threads)
        try:
            return self._run(resume)
        finally:
            torch.set_num_threads(threads)

    def _run(self, resume: bool | None) -> PPOAgent:
        from torchrl.collectors import Collector

        with warnings.catch_warnings(), torch.random.fork_rng(enabled=True):
            warnings.simplefilter("ignore")
            torch.manual_seed(self.seed)
            self._build()
            state = self.checkpoint.read(resume)
            if state is not None:
                self._restore(state)
            self.env.set_seed(self.seed * 1_000_003 + self.frames)
            left = -(-(self.config.frames - self.frames) // self.config.update_every)
            if left > 0:
                collector = Collector(
                    self.env,
                    self.policy,
                    frames_per_batch=self.config.update_every,
                    total_frames=left * self.config.update_every,
                )
                with self._live() as live:
                    self._loop(collector, live)
                collector.shutdown()
            return self._finish()

    def _build(self) -> None:
        from torch.distributions import Categorical
        from torchrl.modules import ProbabilisticActor, ValueOperator
        from torchrl.objectives import ClipPPOLoss
        from torchrl.objectives.value import GAE

        from racines_envs.torchrl_env import ScanEnv

        config = self.config
        self.env = ScanEnv(config.view, config.envs, **self.where)
        self.actor = make_actor(config, self.encoder).to(config.device).eval()
        features = self.encoder.size if self.encoder is not None else 0
        self.critic = ObservationNetwork(config.observation, 1, config.hidden, 1.0, features)
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
        self.best_state = _copy(self.actor)
        self.validation = make_core(config.view, config.validation_starts, **self.where)

    def _loop(self, collector: Any, live: Any) -> None:
        config, began, before = self.config, time.perf_counter(), self.seconds
        for batch in collector:
            losses = self._update(batch)
            last = self.frames
            self.frames += batch.numel()
            self.seconds = before + time.perf_counter() - began
            row = losses | _finished(batch) | {"frames_per_second": self.frames / self.seconds}
            final = self.frames >= config.frames
            if final or self.frames // config.validate_every > last // config.validate_every:
                row |= self._validate()
                self.checkpoint.write(self._state())
            self._log(live, row)

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

    def _validate(self) -> dict[str, float]:
        """Act greedily from the validation starts; keep the policy if none was better."""
        seeds = validation_seeds(self.config.validation_starts).to(self.config.device)
        final = rollout(self.validation, self.agent, seeds).final
        row = {
            "validation/success": float(final["success"].mean()),
            "validation/steps": float(final["steps"].mean()),
            "validation/grade": float(final["grade"].mean()),
            "validation/return": float(final["return"].mean()),
        }
        rank = (row["validation/success"], -row["validation/steps"])
        if rank >= self.best:
            self.best, self.best_state = rank, _copy(self.actor)
        self.history.append({"frames": self.frames, **row})
        return row

    # -- files ---------------------------------------------------------------------------------

    def _live(self) -> Any:
        from dvclive.live import Live

        return Live(
            str(self.folder / "dvclive"), resume=self.frames > 0, save_dvc_exp=False, dvcyaml=None
        )

    def _log(self, live: Any, row: dict[str, float]) -> None:
        live.step = self.frames
        for name, value in row.items():
            live.log_metric(name, value)
        live.sync()
        if self.progress and "validation/success" in row:
            print(
                f"{self.frames:>10,} frames  success {row['validation/success']:.2f}  "
                f"steps {row['validation/steps']:.1f}  {row['frames_per_second']:,.0f} frames/s",
                flush=True,
            )

    def _state(self) -> dict[str, Any]:
        return {
            "frames": self.frames,
            "seconds": self.seconds,
            "best": self.best,
            "best_state": self.best_state,
            "history": self.history,
            "actor": self.actor.state_dict(),
            "critic": self.critic.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "random": torch.get_rng_state(),
        }

    def _restore(self, state: dict[str, Any]) -> None:
        """Continue a run: weights, optimiser and random state; episodes under way start anew."""
        for name in ("actor", "critic", "optimiser"):
            getattr(self, name).load_state_dict(state[name])
        torch.set_rng_state(state["random"])
        for name in ("frames", "seconds", "best_state", "history"):
            setattr(self, name, state[name])
        self.best = tuple(state["best"])

    def _finish(self) -> PPOAgent:
        self.actor.load_state_dict(self.best_state)
        metrics = {
            "frames": self.frames,
            "seconds": round(self.seconds, 1),
            "validation_success": self.best[0],
            "validation_steps": -self.best[1],
            "history": self.history,
        }
        self.agent.save(self.folder, metrics, self.seed)
        discard_checkpoint(self.folder)
        return self.agent


def _copy(network: nn.Module) -> dict[str, Tensor]:
    return {name: value.detach().clone() for name, value in network.state_dict().items()}


def _finished(batch: TensorDictBase) -> dict[str, float]:
    """Return means over the episodes that ended in a batch."""
    done = batch["next", "done"]
    if not bool(done.any()):
        return {}
    means = {}
    for key in ("success", "steps", "return"):
        means[f"train/{key}"] = float(batch["next", "info", key][done].float().mean())
    return means
