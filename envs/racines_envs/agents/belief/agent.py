"""PPO from what a servo's readings add up to: one policy that is told which view to find.

The servo has learned to read images, and steers by rules that were written for it. Here the
steering is learned: where to go, how long to look, and when to declare; first from a planner that
knows the truth, then from reward. The network that reads is frozen and known by its hash.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from torch import Tensor, nn
from torch.nn.functional import cross_entropy, smooth_l1_loss

from racines_data.errors import RacinesError
from racines_data.patients.memory import MEMORY
from racines_data.patients.splits import seeds_of
from racines_data.world import World
from racines_envs.agents.belief.sight import Episodes, Sight
from racines_envs.agents.memory.eyes import Eyes, eyes_like, eyes_of
from racines_envs.agents.policy import choose
from racines_envs.agents.ppo import PPOAgent, PPOConfig, PPOTraining
from racines_envs.agents.training import TrainingRun
from racines_envs.task.core import ScanCore
from racines_envs.task.names import HEART_TIER
from racines_envs.task.tasks import get_task
from racines_envs.worlds.making import WorldLike
from racines_envs.worlds.ward import make_ward
from racines_models.networks.batching import in_fixed_batches

if TYPE_CHECKING:
    from tensordict import TensorDictBase
    from torchrl.envs import EnvBase


@dataclass(frozen=True)
class PPOBeliefConfig(PPOConfig):
    """Through whose eyes it sees, whether it remembers, and on whom it learns."""

    view: str = "AnyView-patients"
    """A task on patients; of `AnyView` one policy learns to find all views."""
    observation: str = "multimodal"
    members: str = "servo"
    """Run of a servo, a name, trained here or published, or a folder. A training sees through the
    servo's of the same seed."""
    memory: bool = True
    """Add up the readings of an episode; False: it knows the looks of its window alone."""
    window: int = 1
    """Looks that it is told of, the last and those before. Of more than one it is told where the
    probe was, too."""
    recurrent: bool = False
    """Read them one after the other by a GRU, which learns what to remember of them; False: side by
    side, as a frame stack."""
    imitate: int = 60_000
    """Of the frames so many, the first, teach it what the planner would do who knows the truth, on
    its own ways (DAgger); reward teaches it from there on. 0: reward alone."""
    first: int = 1_000
    """Train patients left out before its own: those that the servo knows from its training."""

    def __post_init__(self) -> None:
        task = get_task(self.view)
        if task.tier == HEART_TIER:
            raise RacinesError(
                f"agents.ppo-belief.view: {self.view} has one heart, and a servo reads patients: "
                "use --tier patients or beating"
            )
        if self.observation != "multimodal" or self.encoder or self.backend != "phantom":
            raise RacinesError(
                "agents.ppo-belief: it sees image and pose through a servo, of the phantom: leave "
                "observation, encoder and backend out"
            )
        if not 0 <= self.imitate <= self.frames:
            raise RacinesError(
                f"agents.ppo-belief.imitate: {self.imitate}: give 0 to frames, {self.frames}"
            )
        if not 1 + self.recurrent <= self.window <= task.max_steps:
            raise RacinesError(
                f"agents.ppo-belief.window: {self.window}: give 1 to {task.max_steps} looks, "
                "as many as an episode has steps; 2 or more to be recurrent"
            )
        if self.collectors != 1:
            raise RacinesError("agents.ppo-belief.collectors: beliefs stay in one process: give 1")
        known = len(seeds_of("train"))
        if not 0 <= self.first <= known - self.patients:
            raise RacinesError(
                f"agents.ppo-belief: {self.patients} train patients after the first {self.first}: "
                f"there are {known}"
            )


class _Training(PPOTraining):
    """PPO whose environment tells what has been seen so far."""

    def opened(self) -> Any:
        """Return what it sees through."""
        config: Any = self.config
        return _sight(eyes_of(config.members, self.seed, config.device), config)

    def worlds(self, phantom: WorldLike) -> tuple[World, World]:
        """Return train patients whom the servo does not know, and validation patients."""
        config: Any = self.config
        tier = get_task(config.view).tier
        own = seeds_of("train")[config.first : config.first + config.patients]
        held = max(1, config.patients // 2)
        return (
            make_ward(tier, "train", tuple(own), config.device, MEMORY),
            make_ward(tier, "validation", held, config.device, MEMORY),
        )

    def environment(self) -> "EnvBase":
        """Return the environment, which tells what is seen in place of the images."""
        from racines_envs.agents.belief.transform import seen_through

        return seen_through(super().environment(), self.encoder, self._taught)

    @property
    def _taught(self) -> bool:
        config: Any = self.config
        return config.imitate > 0

    def _build(self) -> None:
        super()._build()
        self.lessons: list[Any] = []

    def _update(self, batch: "TensorDictBase") -> dict[str, float]:
        """Learn from the planner's steps first, then from reward."""
        config: Any = self.config
        if self.frames >= config.imitate:
            self.lessons.clear()
            return super()._update(batch)
        return self._imitate(batch)

    def _imitate(self, batch: "TensorDictBase") -> dict[str, float]:
        """Learn what the planner would have done in all states so far, and what they are worth.

        As in learning by cheating (Chen et al., 2020), who teaches knows what nobody can see; a run
        that was killed begins its lessons anew.
        """
        from racines_envs.agents.belief.transform import TAUGHT

        config = self.config
        batch["next", "reward"] = batch["next", "reward"] * config.reward_scale
        with torch.no_grad():
            self.advantage(batch)
        keys = (*self.actor.keys, TAUGHT, "value_target")
        self.lessons.append(batch.reshape(-1).select(*keys).clone())
        lessons: Any = torch.cat(self.lessons)
        self._refresh_norms(lessons[torch.randperm(len(lessons))[: config.minibatch]])
        count = max(1, config.epochs * config.update_every // config.minibatch)
        total = torch.zeros(2)
        for _ in range(count):
            some = lessons[torch.randint(len(lessons), (config.minibatch,))]
            seen = [some[key] for key in self.actor.keys]
            taught = cross_entropy(self.actor(*seen), some[TAUGHT])
            worth = smooth_l1_loss(self.critic(*seen), some["value_target"])
            self.optimiser.zero_grad()
            (taught + worth).backward()
            nn.utils.clip_grad_norm_(self.loss.parameters(), config.max_gradient)
            self.optimiser.step()
            total += torch.stack([taught.detach(), worth.detach()]).cpu()
        told = dict(zip(("taught", "loss_critic"), (total / count).tolist(), strict=True))
        return {f"update/{key}": value for key, value in told.items()}


class PPOBeliefAgent(PPOAgent):
    """A policy learned from reward that goes by a servo's belief; acts greedily."""

    name: ClassVar[str] = "ppo-belief"
    Config: ClassVar[type] = PPOBeliefConfig
    Learner: ClassVar[type[TrainingRun]] = _Training
    hashed: ClassVar[str] = "eyes_sha256"
    """Not an encoder's: each training sees through another of the servo's."""

    @property
    def any_view(self) -> bool:
        """Whether it finds any view of its tier."""
        return get_task(self.view).any_view

    def attach(self, core: ScanCore) -> None:
        """Begin to see in an environment."""
        self._seen: Episodes = self.sight.begin(core)

    @property
    def sight(self) -> Sight:
        """What it sees through."""
        assert isinstance(self.encoder, Sight)
        return self.encoder

    @torch.no_grad()
    def act(self, observation: dict[str, Tensor], seeds: Tensor) -> Tensor:
        """Return the (N,) most probable actions by all that has been seen."""
        self.actor.eval()
        told = {"features": self._seen.see(observation), "params": observation["params"]}
        device = next(self.actor.parameters()).device
        columns = [told[key].to(device) for key in self.actor.keys]
        logits = in_fixed_batches(self.actor, *columns)
        return choose(logits, seeds, getattr(self.config, "temperature", 0.0))

    @classmethod
    def opened(cls, config: Any, run_dir: Path, sha256: str, device: Any) -> Any:
        """Return the servo's network that a saved policy sees through, by its hash."""
        return _sight(eyes_like(sha256, config.members, run_dir, str(device)), config)


def _sight(eyes: Eyes, config: PPOBeliefConfig) -> Sight:
    return Sight(eyes, config.memory, config.window, config.recurrent)
