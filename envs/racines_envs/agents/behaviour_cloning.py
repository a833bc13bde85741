"""Behaviour cloning (Pomerleau, ALVINN, 1989): imitate what the dataset's trajectories teach.

    frame i ──── unit step? ────> goal j, same trajectory, |j - i| <= horizon, view and grade good

The recorded hand moves a fraction of a unit step a frame, so that its motion from one frame to the
next says little. Hindsight says more: a frame that the hand came to later is a goal that it was on
its way to (relabelling as in Andrychowicz et al., Hindsight Experience Replay, 2017; as supervision
in Ghosh et al., Learning to Reach Goals via Iterated Supervised Learning, 2021). No environment is
touched: neither reward, grader nor oracle; only the recorded images, poses, views and grades.

A patient is swept once a view, and the heart stays where it is. With a `horizon` of 0 the goal is
the best of all frames of the same heart, whichever sweep it was met on.
"""

from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import torch
from torch import Tensor, nn
from torch.optim import AdamW, Optimizer

from racines_data.errors import RacinesError
from racines_data.patients.placement import workspace
from racines_data.store.frames import FrameStore, open_store
from racines_envs.agents.demonstrations import Demonstrations, demonstrations, encode_params, hearts
from racines_envs.agents.networks import open_encoder
from racines_envs.agents.policy import make_actor
from racines_envs.agents.training import LearningAgent, seeded, settings_identity
from racines_envs.task.actions import ACTIONS, IDLE
from racines_envs.task.names import HEART_TIER
from racines_envs.worlds.backends import JudgeLike
from racines_envs.worlds.making import WorldLike, find_task, make_phantom
from racines_models.protocol import Run
from racines_models.provenance import dataset_card
from racines_models.statistics import evidence
from racines_models.training.checkpoint import discard_checkpoint
from racines_models.training.objective import Course, Training, Update
from racines_models.training.trainer import train

READ = 256
"""Images encoded at once."""
LABELLED_BY = ("horizon", "both_ways", "least_grade", "still_grade")
"""Settings of the demonstrations."""
KEPT = ("best", "best_state", "history")
"""Attributes of the learner that a checkpoint holds."""


@dataclass(frozen=True)
class BehaviourCloningConfig:
    """What is imitated and how it is learned."""

    view: str = "SC"
    """The target view; on patients a task's name, such as `A4C-patients`."""
    recordings: str = ""
    """Config of the dataset that is imitated; "": that of the view's tier, `frames` for the one
    heart."""
    observation: str = "image"
    """`image`, `params` or `multimodal`."""
    encoder: str = ""
    """What looks at the image: `pose` (the published pose regressor, frozen), a folder of another,
    or "" for convolutions that learn from the demonstrations alone."""
    horizon: int = 150
    """Frames between a frame and its goal on one trajectory, at most; 0: the goal is the best frame
    of the same heart, on any of its trajectories."""
    both_ways: bool = True
    """Let goals lie before a frame as well: a hand that leaves, played backwards, arrives."""
    least_grade: float = 5.0
    """Grade of a goal, at least."""
    still_grade: float = 6.5
    """Grade of the target view from which on the label is to idle."""
    idle_weight: float = 0.1
    """Weight of the label idle in the loss; most recorded frames dwell in the view."""
    epochs: int = 30
    """Passes over the demonstrations."""
    batch_size: int = 256
    learning_rate: float = 1e-3
    """Peak of AdamW's rate; it falls to zero along a cosine."""
    weight_decay: float = 0.01
    hidden: tuple[int, ...] = (128, 128)
    """Widths of the dense layers."""
    precision: str = "fp32"
    """As the trainer's: `fp32`, mixed `bf16` or `fp16`, or `auto`."""
    ema: float = 0.0
    """Decay of the averaged weights that are judged and kept; 0: none."""
    temperature: float = 2.0
    """Actions are drawn from softmax(logits / temperature), from the decision's seed; 0: the most
    probable one always, which gets stuck where no demonstration has been."""
    threads: int = 0
    """CPU threads; 0 leaves torch as it is."""
    device: str = "cpu"


class _Examples:
    """What an actor reads at the M demonstrations of a split; images stay in the store."""

    def __init__(self, learner: "CloningLearner", split: str) -> None:
        self.store, self.keys = learner.store, learner.actor.keys
        settings = {name: getattr(learner.config, name) for name in LABELLED_BY}
        self.shown = demonstrations(self.store, split, learner.task, **settings)
        self.numbers: dict[str, Tensor] = {}
        if "params" in self.keys:
            parameters = self.store.parameters[self.shown.rows]
            self.numbers["params"] = encode_params(parameters, learner.space)
        if learner.encoder is not None:
            shots = (self.store.take(rows).images for rows in self.shown.rows.split(READ))
            with torch.no_grad():
                parts = [learner.encoder(images.to(learner.device)).cpu() for images in shots]
            self.numbers["features"] = torch.cat(parts)

    def seen(self, index: Tensor, device: torch.device) -> list[Tensor]:
        """Return the network's inputs at (B,) demonstrations."""
        values = {key: value[index] for key, value in self.numbers.items()}
        if "image" in self.keys:
            values["image"] = self.store.take(self.shown.rows[index]).images.unsqueeze(1)
        return [values[key].to(device) for key in self.keys]


class CloningLearner(Course):
    """What the trainer needs of an actor that imitates; the best epoch's weights are kept."""

    name = "behaviour-cloning"

    def __init__(
        self, config: BehaviourCloningConfig, store: FrameStore, seed: int, phantom: WorldLike
    ) -> None:
        if config.epochs < 1 or config.batch_size < 2:
            raise RacinesError("agents.behaviour-cloning: epochs >= 1 and batch_size >= 2, please")
        self.config, self.store, self.seed = config, store, seed
        self.device, self.task = torch.device(config.device), find_task(config.view, phantom)
        one_heart = self.task.tier == HEART_TIER
        if one_heart == (store.patients is not None):
            held = "one heart" if store.patients is None else "patients"
            raise RacinesError(
                f"agents.behaviour-cloning: task {self.task.id} cannot imitate config "
                f"{store.config} of {store.root}, which scans {held}: give another view, or "
                "recordings of its tier"
            )
        looks = config.observation != "params"
        self.encoder = open_encoder(config.encoder, config.device) if looks else None
        self.space: Any = None
        if config.observation != "image":
            world = make_phantom(phantom, "cpu", self.task.anatomy) if one_heart else None
            self.space = world.workspace if world else workspace(torch.device("cpu"))
        self.identity = settings_identity(self.name, config, seed, self.encoder)
        self.identity |= {"data": store.digest}
        self.actor = make_actor(config, self.encoder).to(self.device)
        self.best, self.best_state = float("inf"), deepcopy(self.actor.state_dict())
        self.history: list[dict[str, Any]] = []
        self.weight = torch.ones(len(ACTIONS), device=self.device)
        self.weight[IDLE] = config.idle_weight
        self.train, self.held = (_Examples(self, split) for split in ("train", "validation"))
        # A last batch of one has no variance to normalise by.
        count, rest = divmod(len(self.train.shown.action), config.batch_size)
        self.per_epoch = count + (rest > 1)
        self._forget()

    def _forget(self) -> None:
        self._loss, self._right, self._seen = torch.zeros(()), torch.zeros(()), 0

    @property
    def training(self) -> Training:
        """The trainer's settings: all epochs; a look and a checkpoint an epoch."""
        config, epoch = self.config, self.per_epoch * self.config.batch_size
        every: Any = {"log_every": epoch, "sample_every": epoch, "checkpoint_every": epoch}
        images, size = config.epochs * epoch, config.batch_size
        return Training(images, size, config.precision, config.ema, **every)

    def modules(self) -> dict[str, nn.Module]:
        """Return the actor."""
        return {"actor": self.actor}

    def averaged(self) -> tuple[str, ...]:
        """Name it: its weights are averaged."""
        return ("actor",)

    def optimizers(self) -> dict[str, Optimizer]:
        """Return its AdamW; `rate` is the whole rate."""
        decay = self.config.weight_decay
        return {"actor": AdamW(self.actor.parameters(), lr=1.0, weight_decay=decay)}

    def rate(self, step: int) -> float:
        """Return the learning rate, which falls to zero along a cosine."""
        epoch, number = divmod(step, self.per_epoch)
        done = (epoch + number / self.per_epoch) / self.config.epochs
        return self.config.learning_rate * 0.5 * (1.0 + float(torch.tensor(done * torch.pi).cos()))

    def batches(self, start: int, stop: int) -> Iterator[Tensor]:
        """Yield demonstrations, all of them once an epoch; a resumed run begins with an epoch."""
        size = self.config.batch_size
        for epoch in range(start // size // self.per_epoch, self.config.epochs):
            # An epoch's order depends on seed and epoch alone: a resumed run is the undisturbed.
            order = torch.Generator().manual_seed(self.seed * 1_000_003 + epoch)
            rows = torch.randperm(len(self.train.shown.action), generator=order)
            yield from rows.split(size)[: self.per_epoch]

    def updates(self, nets: Mapping[str, nn.Module], batch: Tensor) -> Iterator[Update]:
        """Yield the one step: cross-entropy of the actions that the demonstrations took."""
        wanted = self.train.shown.action[batch].to(self.device)
        logits = nets["actor"](*self.train.seen(batch, self.device))
        loss = nn.functional.cross_entropy(logits, wanted, self.weight)
        yield Update("actor", loss, {})
        self._loss = self._loss + loss.detach() * len(batch)
        self._right = self._right + (logits.detach().argmax(-1) == wanted).sum()
        self._seen += len(batch)

    def look(self, seen: int, folder: Path) -> dict[str, float]:
        """Judge on the trajectories held out; keep the weights if none were better."""
        logits, action = self._held_logits(), self.held.shown.action
        right, helps = _verdicts(logits, self.held.shown)
        row = {
            "train/loss": float(self._loss) / self._seen,
            "train/action_accuracy": float(self._right) / self._seen,
            "held_out/loss": float(nn.functional.cross_entropy(logits, action)),
            "held_out/action_accuracy": float(right.float().mean()),
            "held_out/helps": float(helps.float().mean()),
        }
        if row["held_out/loss"] <= self.best:
            self.best = row["held_out/loss"]
            self.best_state = deepcopy(self.actor.state_dict())
        self.history.append({"epoch": len(self.history) + 1, **row})
        self._forget()
        return row

    @torch.no_grad()
    def _held_logits(self) -> Tensor:
        rows = torch.arange(len(self.held.shown.action)).split(READ)
        return torch.cat([self.actor(*self.held.seen(b, self.device)).cpu() for b in rows])

    def state(self) -> dict[str, Any]:
        """Return the best weights so far, and the epochs."""
        return {name: getattr(self, name) for name in KEPT}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue after an epoch."""
        for name in KEPT:
            setattr(self, name, state[name])

    def finish(self, figures: dict[str, Any]) -> dict[str, Any]:
        """Go back to the best weights; return the metrics, the trainer's figures among them."""
        self.actor.load_state_dict(self.best_state)
        self.actor.eval()
        right, helps = _verdicts(self._held_logits(), self.held.shown)
        trajectory, over = self.held.shown.trajectory, "trajectories"
        place = trajectory.unique(return_inverse=True)[1]
        if self.store.patients is not None:
            place, over = hearts(self.store, trajectory), "patients"

        def figure(hits: Tensor) -> dict[str, Any]:
            # A mean of each, so that a long one counts as a short one.
            means = torch.bincount(place, hits.double()) / torch.bincount(place)
            return evidence.figure("mean", means, f"mean over {over}", 0.0, 1.0)

        return {
            "epochs": len(self.history),
            "seconds": round(figures["seconds"], 1),
            "training": figures,
            "data": dataset_card(self.store),
            "demonstrations": {
                name: {"frames": len(part.shown.rows), "trajectories": part.shown.trajectories}
                for name, part in (("train", self.train), ("validation", self.held))
            },
            "held_out_action_accuracy": figure(right),
            "held_out_helps": figure(helps),
            "history": self.history,
        }


def _verdicts(logits: Tensor, shown: Demonstrations) -> tuple[Tensor, Tensor]:
    """Return (M,) bool: the label's action; and one that helps (it, or one that goes nearer)."""
    chosen = logits.argmax(-1)
    right = chosen == shown.action
    cost = shown.cost.gather(1, chosen.unsqueeze(1)).squeeze(1)
    nearer = (shown.action != IDLE) & (cost < shown.cost[:, IDLE])
    return right, right | nearer


class BehaviourCloningAgent(LearningAgent):
    """A policy that imitates; draws its actions (see `temperature`)."""

    name: ClassVar[str] = CloningLearner.name
    Config: ClassVar[type] = BehaviourCloningConfig

    @classmethod
    def _learn(
        cls, config: Any, run: Run, phantom: WorldLike, grader: JudgeLike, data: Any,
        engine: Any = None,
    ) -> Self:  # fmt: skip
        """Learn the split `train` and keep the weights of least loss on `validation`."""
        if data is None or isinstance(data, (str, Path)):
            tier = find_task(config.view, phantom).tier
            usual = "frames" if tier == HEART_TIER else tier
            data = open_store(data, config.recordings or usual)
        store = data
        with seeded(run.seed, config.threads):
            learner = CloningLearner(config, store, run.seed, phantom)
            metrics = learner.finish(train(learner, store, learner.training, run, learner))
        agent = cls(config, learner.actor, learner.encoder)
        agent.save(run.folder, metrics, run.seed)
        discard_checkpoint(run.folder)
        return agent
