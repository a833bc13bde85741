"""One training loop for every learned generator, and the pose regressor; it knows no method."""

import time
from typing import Any

import torch
from accelerate import Accelerator
from accelerate.state import AcceleratorState
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.imaging import ImageSource
from racines_data.store.frames import FrameStore
from racines_models.protocol import Run
from racines_models.training.average import Average
from racines_models.training.checkpoint import Checkpoint
from racines_models.training.feed import Feed
from racines_models.training.guard import Guard
from racines_models.training.log import TrainingLog
from racines_models.training.objective import Learner, TrainBatch, Training
from racines_models.training.processes import Processes
from racines_models.training.schedule import Schedule
from racines_models.training.validation import Validation


def train(generator: Learner, store: FrameStore, config: Training, run: Run) -> dict[str, Any]:
    """Train until the budget is spent; leave the averaged weights in the networks.

    On the CPU, a run that was killed and resumed ends in the same bits as an undisturbed one.
    Several processes (see `Processes`) share each batch and train as one; the first writes.

    Returns:
        Metrics: `images` and `steps` trained, `seconds` (of all attempts up to their last
        checkpoints), `images_per_second`, the number of `processes`, the `precision` used, and
        the mean `losses` of the last row of the curves.

    Raises:
        RacinesError: `run.resume` is True and there is no checkpoint of this very run; a loss is
            not finite; the batch cannot be shared by the processes.
    """
    trainer = _Trainer(generator, store, config, run)
    began = time.perf_counter() - trainer.seconds
    device, share = trainer.accelerator.device, trainer.processes.share
    feed = Feed(store, config.batch_size, run.seed, device, share)
    with trainer.log:
        for batch in feed.batches(trainer.seen, trainer.stop):
            trainer.step(batch)
            trainer.seconds = time.perf_counter() - began
            due = [trainer.due(each) for each in _intervals(config)]
            if trainer.guard.every_step or any(due):
                trainer.guard.check(trainer.seen)
            tasks = (trainer.write_row, trainer.sample, trainer.write_checkpoint)
            for task, is_due in zip(tasks, due, strict=True):
                if is_due:
                    task()
    return trainer.finish()


def _intervals(config: Training) -> tuple[int, int, int]:
    return config.log_every, config.sample_every, config.checkpoint_every


class _Trainer:
    """The state of one run: networks, optimizers, average, curves, and how far it has come."""

    def __init__(self, generator: Learner, store: FrameStore, config: Training, run: Run):
        self.generator, self.config, self.folder = generator, config, run.folder
        self.accelerator = accelerator = _accelerator(config, run)
        self.processes = Processes(accelerator, config.batch_size)
        self.modules, optimizers = generator.modules(), generator.optimizers()
        # evaluation_mode: autocast without DistributedDataParallel; `Processes` says why.
        self.nets = {
            key: accelerator.prepare_model(net.train(), evaluation_mode=True)
            for key, net in self.modules.items()
        }
        self.optimizers = {name: accelerator.prepare(each) for name, each in optimizers.items()}
        self.average = Average([self.modules[key] for key in generator.averaged()], config.ema)
        self.validation = Validation(store, run.seed)
        self.stop = -(-config.images // config.batch_size) * config.batch_size
        self.schedule = Schedule(self.optimizers, config, self.stop)
        card = generator.card
        identity = {"name": card.name, "config": card.config, "seed": card.seed, "data": card.data}
        self.checkpoint = Checkpoint(run.folder, identity)
        state = self.checkpoint.read(run.resume)
        self.seen: int = state["seen"] if state else 0
        self.seconds: float = state["seconds"] if state else 0.0
        self.guard = Guard(card.name, accelerator.device, self.seen)
        writes = self.processes.main
        self.log = TrainingLog(run.folder, card.name, self.seen, self.stop, run.progress, writes)
        if state:
            self._restore(state)
        self.processes.start_alike(self.modules.values(), self.seen)

    def due(self, every: int) -> bool:
        """Return whether the last step passed a multiple of `every` images, or was the last."""
        before = self.seen - self.config.batch_size
        return self.seen == self.stop or self.seen // every > before // every

    def step(self, batch: TrainBatch) -> None:
        """Make one batch's optimizer steps."""
        logged: dict[str, Tensor] = {}
        losses: dict[str, Tensor] = {}
        self.schedule.apply(self.seen)
        for update in self.generator.updates(self.nets, batch):
            optimizer = self.optimizers[update.optimizer]
            self.accelerator.backward(update.loss)
            weights = [each for group in optimizer.param_groups for each in group["params"]]
            self.processes.average(weight.grad for weight in weights)
            if self.config.gradient_clip:
                self.accelerator.clip_grad_norm_(weights, self.config.gradient_clip)
            optimizer.step()
            # A loss may reach networks that it does not train: clear them all.
            for each in self.optimizers.values():
                each.zero_grad()
            logged |= update.logged
            # One optimizer may step more than once.
            losses[update.optimizer] = losses.get(update.optimizer, 0.0) + update.loss.detach()
        self.processes.average_buffers(self.modules.values())
        self.guard.add(self.processes.average_scalars(losses))
        self.log.add(self.processes.average_scalars(logged))
        self.average.update()
        self.seen += self.config.batch_size

    def write_row(self) -> None:
        """Write a row of the curves."""
        self.log.row(self.seen)

    def sample(self) -> None:
        """Draw the validation frames with the averaged weights, if it is images that it makes."""
        if not self.processes.main or not isinstance(self.generator, ImageSource):
            return
        with self.average.applied():
            drawn = self.validation.draw(self.generator)
        figures = self.validation.figures(drawn)
        self.log.metrics(self.seen, {key: figures[key] for key in ("mae", "psnr")}, "validation/")
        self.validation.grid(drawn, self.folder / "samples" / f"{self.seen:09d}.png")

    def write_checkpoint(self) -> None:
        """Write everything that a resumed run needs; with several processes, it is alike in all."""
        if not self.processes.main:
            return
        state = {
            "seen": self.seen,
            "seconds": self.seconds,
            "modules": {name: net.state_dict() for name, net in self.modules.items()},
            "optimizers": {name: each.state_dict() for name, each in self.optimizers.items()},
            "scaler": self.accelerator.scaler.state_dict() if self.accelerator.scaler else {},
            "average": self.average.state(),
            "log": self.log.state(),
        }
        self.checkpoint.write(state)

    def _restore(self, state: dict[str, Any]) -> None:
        for name, net in self.modules.items():
            net.load_state_dict(state["modules"][name])
        for name, each in self.optimizers.items():
            each.load_state_dict(state["optimizers"][name])
        if self.accelerator.scaler:
            self.accelerator.scaler.load_state_dict(state["scaler"])
        self.average.restore(state["average"])
        self.log.restore(state["log"], self.accelerator.device)

    def finish(self) -> dict[str, Any]:
        """Leave the averaged, unwrapped networks with the generator and return the metrics."""
        for net in self.nets.values():
            self.accelerator.unwrap_model(net, keep_fp32_wrapper=False)
        self.average.apply()
        return {
            "images": self.seen,
            "steps": self.seen // self.config.batch_size,
            "seconds": round(self.seconds, 3),
            "images_per_second": round(self.seen / self.seconds, 1),
            "processes": self.processes.count,
            "precision": resolve_precision(self.config.precision, self.accelerator.device.type),
            "losses": self.log.last,
        }


def resolve_precision(precision: str, device: str) -> str:
    """Return what `auto` stands for on a device, or the precision named.

    Raises:
        RacinesError: fp16 on a CPU, which would train in full precision and not say so.
    """
    if precision == "fp16" and device == "cpu":
        raise RacinesError("training.precision: fp16 needs a CUDA device; use bf16, fp32 or auto")
    if precision != "auto":
        return precision
    if device == "cpu":
        return "bf16" if torch.cpu._is_amx_tile_supported() else "fp32"
    return "bf16" if torch.cuda.is_bf16_supported() else "fp32"


def _accelerator(config: Training, run: Run) -> Accelerator:
    # Accelerate keeps one state a process and refuses a second run with another precision.
    AcceleratorState._reset_state(reset_partial_state=True)
    precision = resolve_precision(config.precision, run.device)
    mixed = "no" if precision == "fp32" else precision
    return Accelerator(cpu=run.device == "cpu", mixed_precision=mixed)
