"""What every run that learns by acting shares: environments, validation, curves, checkpoints."""

import time
import warnings
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from racines_data.errors import RacinesError
from racines_envs.agents.encoders import open_encoder
from racines_envs.agents.identity import environment_identity, settings_identity
from racines_envs.agents.networks import ObservationNetwork
from racines_envs.agents.policy import PolicyAgent
from racines_envs.agents.rollout import rollout
from racines_envs.agents.training.config import TrainingConfig
from racines_envs.task.rewards import RewardConfig
from racines_envs.task.starts import validation_seeds
from racines_envs.worlds.backends import JudgeLike
from racines_envs.worlds.making import WorldLike, find_task, make_core, make_phantom, phantom_recipe
from racines_models.devices import on_device
from racines_models.training.checkpoint import Checkpoint, discard_checkpoint


class TrainingRun(ABC):
    """One run of one learner; a subclass builds its networks and its loop.

    Its config is a `TrainingConfig`.
    """

    actor: ObservationNetwork
    """The network whose greedy choice is validated and kept; set by `_build`."""
    agent: Any
    """The `PolicyAgent` that acts by it; set by `_build`."""
    trained: tuple[str, ...]
    """Names of the attributes with a `state_dict` that a checkpoint holds."""

    def __init__(
        self,
        cls: type[PolicyAgent],
        config: TrainingConfig,
        folder: Path,
        seed: int,
        phantom: WorldLike,
        grader: JudgeLike,
        progress: bool,
        data: Path | str | None = None,
    ) -> None:
        """Join settings and places; nothing is built before `run`.

        Raises:
            RacinesError: settings that do not fit together, or what they name is not there.
        """
        if config.update_every % config.envs:
            raise RacinesError(
                f"agents.{cls.name}.update_every is {config.update_every}: give a multiple of envs "
                f"({config.envs})"
            )
        config = on_device(config)
        self.folder, self.seed, self.progress = folder, seed, progress
        self.config: Any = config
        looks = config.observation != "params"
        self.encoder = open_encoder(config.encoder, config.device) if looks else None
        anatomy = find_task(config.view, phantom).anatomy
        self.where: dict[str, Any] = {
            "encoder": self.encoder,
            "backend": config.backend,
            "observation": config.observation,
            "reward": config.reward,
            "termination": config.termination or None,
            "generator": config.generator or None,
            "grader": grader or config.grader or None,
            "data": data,
            "rewards": RewardConfig(discount=config.gamma),
            "phantom": make_phantom(phantom, config.device, anatomy),
            "device": config.device,
        }
        self.frames, self.best, self.history = 0, (-1.0, 0.0), []
        self.seconds = self._before = self._began = 0.0
        identity = settings_identity(cls.name, config, seed, self.encoder)
        identity |= environment_identity(config, self.where["phantom"], grader, data)
        self.checkpoint = Checkpoint(folder, identity)

    def run(self, resume: bool | None) -> Any:
        """Act, update, validate, checkpoint, until all frames are seen; return the agent."""
        threads = torch.get_num_threads()
        torch.set_num_threads(self.config.threads or threads)
        try:
            return self._run(resume)
        finally:
            torch.set_num_threads(threads)

    def _run(self, resume: bool | None) -> Any:
        with warnings.catch_warnings(), torch.random.fork_rng(enabled=True):
            warnings.simplefilter("ignore")
            torch.manual_seed(self.seed)
            self._build()
            self.best_state = copy_state(self.actor)
            self.validation = make_core(
                self.config.view, self.config.validation_starts, **self.where
            )
            state = self.checkpoint.read(resume)
            if state is not None:
                self._restore(state)
            if self.frames < self.config.frames:
                with self._live() as live:
                    self._loop(live)
            return self._finish()

    @abstractmethod
    def _build(self) -> None:
        """Make networks, optimiser, loss and environment."""

    @abstractmethod
    def _loop(self, live: Any) -> None:
        """Learn until `frames` is what the config says; call `_count` after each batch."""

    def _count(self, batch: TensorDictBase, losses: dict[str, float], live: Any) -> None:
        """Count a batch of experience, and validate and save where it is time."""
        config, last = self.config, self.frames
        self.frames += batch.numel()
        self.seconds = self._before + time.perf_counter() - self._began
        row = losses | finished(batch) | {"frames_per_second": self.frames / self.seconds}
        final = self.frames >= config.frames
        if final or self.frames // config.validate_every > last // config.validate_every:
            row |= self._validate()
            self.checkpoint.write(self._state())
        self._log(live, row)

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
            self.best, self.best_state = rank, copy_state(self.actor)
        self.history.append({"frames": self.frames, **row})
        return row

    # -- files ---------------------------------------------------------------------------------

    def _live(self) -> Any:
        from dvclive.live import Live

        self._began, self._before = time.perf_counter(), self.seconds
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
            "random": torch.get_rng_state(),
            **{name: getattr(self, name).state_dict() for name in self.trained},
        }

    def _restore(self, state: dict[str, Any]) -> None:
        """Continue a run: weights, optimiser and random state; episodes under way start anew."""
        for name in self.trained:
            getattr(self, name).load_state_dict(state[name])
        torch.set_rng_state(state["random"])
        for name in ("frames", "seconds", "best_state", "history"):
            setattr(self, name, state[name])
        self.best = tuple(state["best"])

    def _finish(self) -> Any:
        self.actor.load_state_dict(self.best_state)
        metrics = {
            "frames": self.frames,
            "seconds": round(self.seconds, 1),
            "validation_success": self.best[0],
            "validation_steps": -self.best[1],
            "phantom": phantom_recipe(self.where["phantom"]),
            "history": self.history,
        }
        self.agent.save(self.folder, metrics, self.seed)
        discard_checkpoint(self.folder)
        return self.agent


def copy_state(network: nn.Module) -> dict[str, Tensor]:
    """Return a copy of a network's state that later training leaves alone."""
    return {name: value.detach().clone() for name, value in network.state_dict().items()}


def finished(batch: TensorDictBase) -> dict[str, float]:
    """Return means over the episodes that ended in a batch."""
    done = batch["next", "done"]
    if not bool(done.any()):
        return {}
    means = {}
    for key in ("success", "steps", "return"):
        means[f"train/{key}"] = float(batch["next", "info", key][done].float().mean())
    return means
