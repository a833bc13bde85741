"""What agents that learn share: environments, validation, curves, checkpoints.

A checkpoint must agree in a run's settings and in the content of all that it rests on. Encoder,
grader and generator count by the hash of their weights, not by where they lie: a run goes on where
a folder was moved, and not where it holds something else by now.
"""

import time
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self, cast

import torch

from racines_data.engines import Engine
from racines_data.errors import RacinesError
from racines_data.extras import needed
from racines_data.store.frames import FrameStore, open_store
from racines_data.terminal import quiet, say
from racines_data.world import World
from racines_envs.agents.gathering import gathered
from racines_envs.agents.learned_in import worlds
from racines_envs.agents.networks import PoseEncoder, open_encoder
from racines_envs.agents.policy import PolicyAgent, make_actor, told_settings
from racines_envs.agents.rollout import rollout
from racines_envs.agents.settings import TrainingConfig
from racines_envs.task.rewards import RewardConfig, get_reward
from racines_envs.task.starts import validation_seeds
from racines_envs.worlds.backends import JudgeLike, make_grader, source_weights, usual_grader
from racines_envs.worlds.making import WorldLike, find_task, make_core, phantom_recipe
from racines_envs.worlds.recorded.world import Recordings
from racines_models.devices import on_device
from racines_models.protocol import Run
from racines_models.training.checkpoint import Checkpoint, discard_checkpoint
from racines_models.training.curves import Curves

if TYPE_CHECKING:
    from tensordict import TensorDictBase

PLACES = ("encoder", "grader", "generator")
"""Settings that name a place."""
FINISHED, VALIDATED = ("success", "steps", "return"), ("success", "steps", "grade", "return")
"""What the curves tell of the episodes that ended in training, and of those of a validation."""
KEPT = ("frames", "seconds", "best", "best_state", "history")
"""Attributes of a run that a checkpoint holds as they are."""


class TrainingRun(ABC):
    """One run of one learner; a subclass adds what it learns with, and an update.

    Its config is a `TrainingConfig`.
    """

    policy: Any
    """What gathers experience; set by `_build`."""
    trained: tuple[str, ...]
    """Names of the attributes with a `state_dict` that a checkpoint holds."""

    def __init__(
        self, cls: type[PolicyAgent], config: TrainingConfig, folder: Path, seed: int,
        phantom: WorldLike, grader: JudgeLike, progress: bool, data: Path | str | None = None,
    ) -> None:  # fmt: skip
        """Check settings and what they name, and join them; nothing is built before `run`."""
        if config.update_every % config.envs:
            raise RacinesError(
                f"agents.{cls.name}.update_every is {config.update_every}: give a multiple of envs "
                f"({config.envs})"
            )
        if config.collectors < 1 or config.envs % config.collectors:
            raise RacinesError(
                f"agents.{cls.name}.collectors is {config.collectors}: give a divisor of envs "
                f"({config.envs})"
            )
        needed("torchrl", f"training {cls.name}")
        self.folder, self.seed, self.progress = folder, seed, progress
        self.cls, self.config = cls, cast(Any, config)
        self.encoder: Any = self.opened()
        world, self._validated_in = self.worlds(phantom)
        self.where: dict[str, Any] = {
            "encoder": self.encoder if isinstance(self.encoder, PoseEncoder) else None,
            "backend": config.backend,
            "observation": config.observation,
            "reward": config.reward,
            "termination": config.termination or None,
            "generator": config.generator or None,
            "grader": grader or config.grader or None,
            "data": data,
            "robot": config.robot,
            "rewards": RewardConfig(discount=config.gamma),
            "phantom": world,
            "device": config.device,
        }
        self.frames, self.seconds, self.best, self.history = 0, 0.0, (-1.0, 0.0), []
        identity = settings_identity(cls.name, config, seed, self.encoder)
        identity |= environment_identity(config, self.where["phantom"], grader, data)
        self.identity, self.given = identity, (phantom, grader, data)
        self.checkpoint = Checkpoint(folder, identity)

    def run(self, resume: bool | None, engine: Engine | None = None) -> Any:
        """Act, update, validate, checkpoint, until all frames are seen; return the agent.

        Several `collectors` act on the `engine`, or here.
        """
        with warnings.catch_warnings(), seeded(self.seed, self.config.threads):
            warnings.simplefilter("ignore")
            self._build()
            self.best_state = deepcopy(self.actor.state_dict())
            view, starts = self.config.view, self.config.validation_starts
            elsewhere: dict[str, Any] = {**self.where, "phantom": self._validated_in}
            self.validation = make_core(view, starts, **elsewhere)
            state = self.checkpoint.read(resume)
            if state is not None:
                self._restore(state)
            if self.frames < self.config.frames:
                self._loop(engine)
            return self._finish()

    def opened(self) -> Any:
        """Return what it looks at images through; None if it learns to see, or sees none."""
        looks = self.config.observation != "params"
        return open_encoder(self.config.encoder, self.config.device) if looks else None

    def worlds(self, phantom: WorldLike) -> tuple[World, World]:
        """Return where it learns and where it is validated."""
        return worlds(self.config, phantom)

    def environment(self) -> Any:
        """Return the environment that it gathers experience in."""
        from racines_envs.apis.torchrl_env import ScanEnv

        return ScanEnv(self.config.view, self.config.envs, **self.where)

    def _build(self) -> None:
        """Make the environment, and the actor whose greedy choice is validated and kept."""
        self.env = self.environment()
        self.actor = (
            make_actor(self.config, self.encoder, self.cls.outputs).to(self.config.device).eval()
        )
        self.agent: Any = self.cls(self.config, self.actor, self.encoder)

    @abstractmethod
    def _update(self, batch: "TensorDictBase") -> dict[str, float]:
        """Learn from a batch (envs, steps) of experience; return figures for the curves."""

    @property
    def starts(self) -> int:
        """The seed of the first environment's episodes, from here on."""
        return self.seed * 1_000_003 + self.frames

    def _loop(self, engine: Engine | None) -> None:
        """Gather and learn until `frames` is what the config says."""
        config, began = self.config, time.perf_counter() - self.seconds
        every = config.validate_every
        with Curves(self.folder, self.frames) as curves:
            for batch in self._experience() if config.collectors == 1 else gathered(self, engine):
                row, last = self._update(batch) | finished(batch), self.frames // every
                self.frames += batch.numel()
                self.seconds = time.perf_counter() - began
                row["frames_per_second"] = self.frames / self.seconds
                if self.frames >= config.frames or self.frames // every > last:
                    row |= self._validate()
                self._log(curves, row)
                if self.frames >= config.frames:
                    return

    def _experience(self) -> Iterator["TensorDictBase"]:
        """Yield batches (envs, steps) of what all environments do here."""
        from torchrl.collectors import Collector

        self.env.set_seed(self.starts)
        size = self.config.update_every
        left = -(-(self.config.frames - self.frames) // size) * size
        collector = Collector(self.env, self.policy, frames_per_batch=size, total_frames=left)
        try:
            yield from collector
        finally:
            collector.shutdown()

    def _validate(self) -> dict[str, float]:
        """Act greedily from the validation starts, keep the policy if none was better, and save."""
        seeds = validation_seeds(self.config.validation_starts).to(self.config.device)
        final = rollout(self.validation, self.agent, seeds).final
        row = {f"validation/{key}": float(final[key].mean()) for key in VALIDATED}
        rank = (row["validation/success"], -row["validation/steps"])
        if rank >= self.best:
            self.best, self.best_state = rank, deepcopy(self.actor.state_dict())
        self.history.append({"frames": self.frames, **row})
        self.checkpoint.write(self._state())
        return row

    def _log(self, curves: Curves, row: dict[str, float]) -> None:
        curves.row(self.frames, row)
        if self.progress and "validation/success" in row and not quiet():
            say(
                f"{self.frames:>10,} frames  success {row['validation/success']:.2f}  "
                f"steps {row['validation/steps']:.1f}  {row['frames_per_second']:,.0f} frames/s"
            )

    def _state(self) -> dict[str, Any]:
        trained = {name: getattr(self, name).state_dict() for name in self.trained}
        kept = {name: getattr(self, name) for name in KEPT}
        return kept | trained | {"random": torch.get_rng_state()}

    def _restore(self, state: dict[str, Any]) -> None:
        """Continue a run: weights, optimiser and random state; episodes under way start anew."""
        for name in self.trained:
            getattr(self, name).load_state_dict(state[name])
        for name in KEPT:
            setattr(self, name, state[name])
        torch.set_rng_state(state["random"])

    def _finish(self) -> PolicyAgent:
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


class LearningAgent(PolicyAgent):
    """A policy that learns; a subclass adds `name` and `Config`, and the `Learner` of its runs."""

    Learner: ClassVar[type[TrainingRun]]

    @classmethod
    def train(
        cls, config: Any, run_dir: Path, *, seed: int = 0, phantom: WorldLike = None,
        grader: JudgeLike = None, data: FrameStore | Path | str | None = None,
        resume: bool | None = None, progress: bool = True, engine: Engine | None = None,
        **where: Any,
    ) -> Self:  # fmt: skip
        """Train and save the policy that validated best.

        Args:
            config: Of the class `Config`.
            run_dir: Receives policy, metrics and curves, and checkpoints while it trains.
            seed: Of weights, episodes and draws.
            phantom: A phantom or its configuration; the shared default by default.
            grader: For the reward `paper`, instead of the folder in the settings.
            data: Dataset to replay (its folder) or to imitate (also open); data/racines by default.
            resume: True: go on from the last checkpoint, which must be there; False: start anew;
                None: go on if there is a checkpoint of this very run.
            progress: Tell how far it is.
            engine: Where several `collectors` act; None: here.
            where: Taken for the protocol's sake; nothing more is known.

        Raises:
            RacinesError: settings that do not fit together, nothing to learn from, or a checkpoint
                of another run.
        """
        config = on_device(config)
        run = Run(Path(run_dir), seed, config.device, resume, progress)
        return cls._learn(config, run, phantom, grader, data, engine)

    @classmethod
    def _learn(
        cls, config: Any, run: Run, phantom: WorldLike, grader: JudgeLike, data: Any,
        engine: Engine | None = None,
    ) -> Self:  # fmt: skip
        where = (run.folder, run.seed, phantom, grader, run.progress, data)
        return cls.Learner(cls, config, *where).run(run.resume, engine)


def settings_identity(
    name: str, config: Any, seed: int, encoder: PoseEncoder | None
) -> dict[str, Any]:
    """Return the settings of an agent's run, its encoder by content; every value is plain."""
    settings = {key: value for key, value in told_settings(config).items() if key not in PLACES}
    settings |= {"hidden": list(config.hidden)}
    sha256 = encoder.sha256 if encoder is not None else None
    return {"agent": name, "seed": seed, **settings, "encoder": sha256}


def environment_identity(
    config: TrainingConfig, phantom: WorldLike, grader: JudgeLike = None, data: Any = None
) -> dict[str, Any]:
    """Return what an environment is made of, by content; None for what it does without.

    `grader` goes before the folder in the settings, `data` is that of the backend `replay`.
    """
    made: dict[str, Any] = {"grader": None, "generator": None, "data": None}
    if get_reward(config.reward).needs_judge:
        judge = grader or config.grader or usual_grader(find_task(config.view, phantom))
        made["grader"] = make_grader(judge, "cpu").sha256
    if config.backend == "generator" and config.generator:
        made["generator"] = source_weights(config.generator)
    if config.backend == "replay" and not isinstance(phantom, Recordings):
        made["data"] = open_store(data).digest
    return made | {"phantom": phantom_recipe(phantom)}


@contextmanager
def seeded(seed: int, threads: int) -> Iterator[None]:
    """Draw from a seed, on so many CPU threads (0: as before); leave both as they were."""
    before = torch.get_num_threads()
    torch.set_num_threads(threads or before)
    try:
        with torch.random.fork_rng(enabled=True):
            torch.manual_seed(seed)
            yield
    finally:
        torch.set_num_threads(before)


def finished(batch: "TensorDictBase") -> dict[str, float]:
    """Return means over the episodes that ended in a batch."""
    done = batch["next", "done"]
    if not bool(done.any()):
        return {}
    ended = {key: batch["next", "info", key][done] for key in FINISHED}
    return {f"train/{key}": float(value.float().mean()) for key, value in ended.items()}
