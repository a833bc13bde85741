"""Behaviour cloning (Pomerleau, ALVINN, 1989): imitate what the dataset's trajectories teach.

The labels are unit steps by hindsight (see `demonstrations`). No environment is touched: neither
reward, grader nor oracle; only the recorded images, poses, views and grades.
"""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from racines_data.errors import RacinesError
from racines_data.store.frames import FrameStore, open_store
from racines_envs.agents.demonstrations import Demonstrations, demonstrations, encode_params
from racines_envs.agents.encoders import open_encoder
from racines_envs.agents.identity import settings_identity
from racines_envs.agents.policy import PolicyAgent, make_actor
from racines_envs.agents.training.run import copy_state
from racines_envs.task.actions import ACTIONS, IDLE
from racines_envs.worlds.making import WorldLike, find_task, make_phantom
from racines_models.devices import on_device
from racines_models.provenance import dataset_card
from racines_models.training.checkpoint import Checkpoint, discard_checkpoint

READ = 256
"""Images encoded at once."""


@dataclass(frozen=True)
class BehaviourCloningConfig:
    """What is imitated and how it is learned."""

    view: str = "SC"
    """The target view."""
    observation: str = "image"
    """`image`, `params` or `multimodal`."""
    encoder: str = ""
    """What looks at the image: `pose` (the published pose regressor, frozen), a folder of another,
    or "" for convolutions that learn from the demonstrations alone."""
    horizon: int = 150
    """Frames between a frame and its goal, at most."""
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
    temperature: float = 2.0
    """Actions are drawn from softmax(logits / temperature), from the decision's seed; 0: the most
    probable one always, which gets stuck where no demonstration has been."""
    threads: int = 0
    """CPU threads; 0 leaves torch as it is."""
    device: str = "cpu"


class BehaviourCloningAgent(PolicyAgent):
    """A policy that imitates; draws its actions (see `temperature`)."""

    name: ClassVar[str] = "behaviour-cloning"
    Config: ClassVar[type] = BehaviourCloningConfig

    @classmethod
    def train(
        cls,
        config: BehaviourCloningConfig,
        run_dir: Path,
        *,
        data: FrameStore | Path | str | None = None,
        seed: int = 0,
        phantom: WorldLike = None,
        resume: bool | None = None,
        progress: bool = True,
        **where: Any,
    ) -> "BehaviourCloningAgent":
        """Learn the split `train` and keep the weights of least loss on `validation`.

        Args:
            config: The settings.
            run_dir: Receives policy, metrics and curves, and a checkpoint an epoch.
            data: Folder of the dataset, or its open store; data/racines by default.
            seed: Of weights and order.
            phantom: A phantom or its configuration, for the workspace that `params` are scaled by.
            resume: As `PPOAgent.train`.
            progress: Print a line an epoch.
            where: Taken for the protocol's sake; nothing more is known.

        Raises:
            RacinesError: no dataset, no demonstrations in it, or a checkpoint of another run.
        """
        store = open_store(data) if data is None or isinstance(data, (str, Path)) else data
        return _Imitation(config, Path(run_dir), store, seed, phantom, progress).run(resume)


class _Examples:
    """What the network reads at M demonstrations; images stay in the store."""

    def __init__(
        self, store: FrameStore, shown: Demonstrations, keys: list[str], encoder: Any, space: Any
    ) -> None:
        self.store, self.shown, self.keys = store, shown, keys
        self.numbers: dict[str, Tensor] = {}
        if "params" in keys:
            self.numbers["params"] = encode_params(store.parameters[shown.rows], space)
        if "features" in keys:
            device = next(encoder.parameters()).device
            with torch.no_grad():
                parts = [
                    encoder(store.take(rows).images.to(device)).cpu()
                    for rows in shown.rows.split(READ)
                ]
            self.numbers["features"] = torch.cat(parts)

    def seen(self, index: Tensor, device: torch.device) -> list[Tensor]:
        """Return the network's inputs at (B,) demonstrations."""
        values = {key: value[index] for key, value in self.numbers.items()}
        if "image" in self.keys:
            values["image"] = self.store.take(self.shown.rows[index]).images.unsqueeze(1)
        return [values[key].to(device) for key in self.keys]


class _Imitation:
    """One run."""

    def __init__(
        self,
        config: BehaviourCloningConfig,
        folder: Path,
        store: FrameStore,
        seed: int,
        phantom: WorldLike,
        progress: bool,
    ) -> None:
        if config.epochs < 1 or config.batch_size < 2:
            raise RacinesError("agents.behaviour-cloning: epochs >= 1 and batch_size >= 2, please")
        config = on_device(config)
        self.config, self.folder, self.store = config, folder, store
        self.seed, self.progress = seed, progress
        self.device = torch.device(config.device)
        self.task = find_task(config.view, phantom)
        looks = config.observation != "params"
        self.encoder = open_encoder(config.encoder, config.device) if looks else None
        self.space = None
        if config.observation != "image":
            self.space = make_phantom(phantom, "cpu", self.task.anatomy).workspace
        self.epoch, self.seconds, self.best, self.history = 0, 0.0, float("inf"), []
        identity = settings_identity(BehaviourCloningAgent.name, config, seed, self.encoder)
        identity |= {"data": store.digest}
        self.checkpoint = Checkpoint(folder, identity)

    def run(self, resume: bool | None) -> BehaviourCloningAgent:
        """Label, learn, keep the best."""
        threads = torch.get_num_threads()
        torch.set_num_threads(self.config.threads or threads)
        try:
            with torch.random.fork_rng(enabled=True):
                torch.manual_seed(self.seed)
                self._build()
                self._restore(self.checkpoint.read(resume))
                self._loop()
                return self._finish()
        finally:
            torch.set_num_threads(threads)

    def _build(self) -> None:
        config = self.config
        self.actor = make_actor(config, self.encoder).to(self.device)
        self.agent = BehaviourCloningAgent(config, self.actor, self.encoder)
        self.optimiser = torch.optim.AdamW(
            self.actor.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay
        )
        self.best_state = copy_state(self.actor)
        self.weight = torch.ones(len(ACTIONS), device=self.device)
        self.weight[IDLE] = config.idle_weight
        self.train, self.held = (self._examples(split) for split in ("train", "validation"))

    def _examples(self, split: str) -> _Examples:
        config = self.config
        shown = demonstrations(
            self.store,
            split,
            self.task,
            horizon=config.horizon,
            both_ways=config.both_ways,
            least_grade=config.least_grade,
            still_grade=config.still_grade,
        )
        return _Examples(self.store, shown, self.actor.keys, self.encoder, self.space)

    def _loop(self) -> None:
        if self.epoch >= self.config.epochs:
            return
        from dvclive.live import Live

        began, before = time.perf_counter(), self.seconds
        place = str(self.folder / "dvclive")
        with Live(place, resume=self.epoch > 0, save_dvc_exp=False, dvcyaml=None) as live:
            while self.epoch < self.config.epochs:
                row = self._pass() | self._judge()
                self.epoch += 1
                self.seconds = before + time.perf_counter() - began
                if row["held_out/loss"] <= self.best:
                    self.best, self.best_state = row["held_out/loss"], copy_state(self.actor)
                self.history.append({"epoch": self.epoch, **row})
                self._log(live, row)
                self.checkpoint.write(self._state())

    def _pass(self) -> dict[str, float]:
        """Learn every demonstration once."""
        config, labels = self.config, self.train.shown.action
        self.actor.train()
        # An epoch's order depends on seed and epoch alone, so a resumed run is the undisturbed one.
        order = torch.Generator().manual_seed(self.seed * 1_000_003 + self.epoch)
        rows = torch.randperm(len(labels), generator=order)
        # A last batch of one has no variance to normalise by.
        batches = [batch for batch in rows.split(config.batch_size) if len(batch) > 1]
        total, right, seen = 0.0, 0, 0
        for number, batch in enumerate(batches):
            done = (self.epoch + number / len(batches)) / config.epochs
            rate = config.learning_rate * 0.5 * (1.0 + float(torch.tensor(done * torch.pi).cos()))
            self.optimiser.param_groups[0]["lr"] = rate
            wanted = labels[batch].to(self.device)
            logits = self.actor(*self.train.seen(batch, self.device))
            loss = nn.functional.cross_entropy(logits, wanted, self.weight)
            self.optimiser.zero_grad()
            loss.backward()
            self.optimiser.step()
            total = total + loss.detach() * len(batch)
            right = right + (logits.detach().argmax(-1) == wanted).sum()
            seen += len(batch)
        self.actor.eval()
        return {"train/loss": float(total) / seen, "train/action_accuracy": float(right) / seen}

    @torch.no_grad()
    def _held_logits(self) -> Tensor:
        rows = torch.arange(len(self.held.shown.action)).split(READ)
        return torch.cat([self.actor(*self.held.seen(b, self.device)).cpu() for b in rows])

    def _judge(self) -> dict[str, float]:
        """Return loss and accuracies on the trajectories held out."""
        logits, action = self._held_logits(), self.held.shown.action
        right, helps = _verdicts(logits, self.held.shown)
        return {
            "held_out/loss": float(nn.functional.cross_entropy(logits, action)),
            "held_out/action_accuracy": float(right.float().mean()),
            "held_out/helps": float(helps.float().mean()),
        }

    def _log(self, live: Any, row: dict[str, float]) -> None:
        live.step = self.epoch
        for name, value in row.items():
            live.log_metric(name, value)
        live.sync()
        if self.progress:
            print(
                f"epoch {self.epoch:>3}  loss {row['train/loss']:.3f}  held out: loss "
                f"{row['held_out/loss']:.3f}  right {row['held_out/action_accuracy']:.3f}  "
                f"helps {row['held_out/helps']:.3f}",
                flush=True,
            )

    def _state(self) -> dict[str, Any]:
        names = ("epoch", "seconds", "best", "best_state", "history")
        state = {name: getattr(self, name) for name in names}
        return state | {"actor": self.actor.state_dict(), "optimiser": self.optimiser.state_dict()}

    def _restore(self, state: dict[str, Any] | None) -> None:
        for name, value in (state or {}).items():
            if name in ("actor", "optimiser"):
                getattr(self, name).load_state_dict(value)
            else:
                setattr(self, name, value)

    def _finish(self) -> BehaviourCloningAgent:
        from racines_models import statistics

        self.actor.load_state_dict(self.best_state)
        self.actor.eval()
        right, helps = _verdicts(self._held_logits(), self.held.shown)
        groups = self.held.shown.trajectory

        def figure(hits: Tensor) -> dict[str, Any]:
            return statistics.mean(_by_group(hits, groups).numpy(), "mean over trajectories")

        metrics = {
            "epochs": self.epoch,
            "seconds": round(self.seconds, 1),
            "data": dataset_card(self.store),
            "demonstrations": {
                name: {"frames": len(part.shown.rows), "trajectories": part.shown.trajectories}
                for name, part in (("train", self.train), ("validation", self.held))
            },
            "held_out_action_accuracy": figure(right),
            "held_out_helps": figure(helps),
            "history": self.history,
        }
        self.agent.save(self.folder, metrics, self.seed)
        discard_checkpoint(self.folder)
        return self.agent


def _verdicts(logits: Tensor, shown: Demonstrations) -> tuple[Tensor, Tensor]:
    """Return (M,) bool: the label's action; and one that helps (it, or one that goes nearer)."""
    chosen = logits.argmax(-1)
    right = chosen == shown.action
    cost = shown.cost.gather(1, chosen.unsqueeze(1)).squeeze(1)
    nearer = (shown.action != IDLE) & (cost < shown.cost[:, IDLE])
    return right, right | nearer


def _by_group(hits: Tensor, groups: Tensor) -> Tensor:
    """Return the mean of each group, so that a long trajectory counts as a short one."""
    place = groups.unique(return_inverse=True)[1]
    return torch.bincount(place, hits.double()) / torch.bincount(place)
