"""One training loop for generators, judges and cloned agents; it knows no method."""

import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn
from torch.optim.lr_scheduler import LambdaLR
from torch.optim.swa_utils import AveragedModel

from racines_data.errors import RacinesError
from racines_data.extras import needed
from racines_data.store.frames import FrameStore
from racines_models.devices import check_compiler
from racines_models.protocol import Run
from racines_models.training.checkpoint import Checkpoint
from racines_models.training.log import Guard, TrainingLog
from racines_models.training.objective import Course, FrameCourse, Learner, Training
from racines_models.training.processes import Processes

if TYPE_CHECKING:
    from accelerate import Accelerator


def train(
    learner: Learner,
    store: FrameStore | None,
    config: Training,
    run: Run,
    course: Course | None = None,
    checkpoint_seconds: float = 0.0,
) -> dict[str, Any]:
    """Train until the budget is spent; leave the averaged weights in the networks.

    On the CPU, a run that was killed and resumed ends in the same bits as an undisturbed one.
    Several processes (see `Processes`) share each batch and train as one; the first writes.

    The device of `run` is there (see `resolve_device`). Without a `course`, which may bring frames
    of its own and need no `store`, the train split is fed by the config. Between two checkpoints
    lie `checkpoint_seconds` at least.

    Returns:
        Metrics: `images` and `steps` trained, `seconds` (of all attempts up to their last
        checkpoints), `images_per_second`, the number of `processes`, the `precision` used, and
        the mean `losses` of the last row of the curves.

    Raises:
        RacinesError: `run.resume` is True and there is no checkpoint of this very run; a loss is
            not finite; the batch cannot be shared by the processes.
    """
    trainer = _Trainer(learner, store, config, run, course)
    batches = trainer.course.batches(trainer.seen, config.stop)
    began = saved = time.perf_counter()
    began -= trainer.seconds
    tasks = (
        (config.log_every, lambda: trainer.log.row(trainer.seen)),
        (config.sample_every, trainer.look),
        (config.checkpoint_every, trainer.write_checkpoint),
    )
    with trainer.log, warnings.catch_warnings():
        # The optimizer of a later stage has its rate moved before its first step.
        warnings.filterwarnings("ignore", "Detected call of")
        for batch in batches:
            trainer.step(batch)
            now = time.perf_counter()
            trainer.seconds = now - began
            due = [task for every, task in tasks if trainer.due(every)]
            if trainer.write_checkpoint in due and now - saved < checkpoint_seconds:
                due.remove(trainer.write_checkpoint)
            if trainer.guard.every_step or due:
                trainer.guard.check(trainer.seen)
            for task in due:
                task()
            saved = now if trainer.write_checkpoint in due else saved
    return trainer.finish()


class _Trainer:
    """The state of one run: networks, optimizers, average, curves, and how far it has come."""

    def __init__(
        self, learner: Learner, store: FrameStore | None, config: Training, run: Run,
        course: Course | None,
    ):  # fmt: skip
        self.learner, self.config, self.folder = learner, config, run.folder
        self.accelerator = accelerator = _accelerator(config, run)
        self.processes = Processes(accelerator, config.batch_size)
        if course is not None and self.processes.count > 1:
            raise RacinesError(f"{learner.name} trains in one process: start one")
        device, share = accelerator.device, self.processes.share
        if course is None:
            if store is None:
                raise RacinesError(f"{learner.name} has no frames to train on: give a store")
            course = FrameCourse(learner, store, config, run, device, share)
        self.course = course
        self.modules, optimizers = learner.modules(), learner.optimizers()
        # evaluation_mode: autocast without DistributedDataParallel; `Processes` says why.
        self.nets = {
            key: accelerator.prepare_model(net.train(), evaluation_mode=True)
            for key, net in self.modules.items()
        }
        self.optimizers = {name: accelerator.prepare(each) for name, each in optimizers.items()}
        self.schedules = [LambdaLR(each, self.course.rate) for each in optimizers.values()]
        self.average = Average([self.modules[key] for key in learner.averaged()], config.ema)
        self.checkpoint = Checkpoint(run.folder, learner.identity)
        state = self.checkpoint.read(run.resume)
        self.seen: int = state["seen"] if state else 0
        self.seconds: float = state["seconds"] if state else 0.0
        self.guard = Guard(learner.name, device, self.seen)
        shown, main = run.progress, self.processes.main
        self.log = TrainingLog(run.folder, learner.name, self.seen, config.stop, shown, main)
        if state and self.seen:
            self._restore(state)
        self.processes.start_alike(self.modules.values(), self.seen)

    def due(self, every: int) -> bool:
        """Return whether the last step passed a multiple of `every` images, or was the last."""
        before = self.seen - self.config.batch_size
        return self.seen == self.config.stop or self.seen // every > before // every

    def step(self, batch: Any) -> None:
        """Make one batch's optimizer steps."""
        logged: dict[str, Tensor] = {}
        losses: dict[str, Tensor] = {}
        for update in self.learner.updates(self.nets, batch):
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
        # Running statistics: each process saw its own share of the batch.
        self.processes.average(x for net in self.modules.values() for x in net.buffers())
        self.guard.add(self.processes.average_scalars(losses))
        self.log.add(self.processes.average_scalars(logged))
        self.average.update()
        for schedule in self.schedules:
            schedule.step()
        self.seen += self.config.batch_size

    def look(self) -> None:
        """Let the course look at the averaged networks."""
        if self.processes.main:
            with self.average.applied():
                figures = self.course.look(self.seen, self.folder)
            self.log.metrics(self.seen, figures)

    def write_checkpoint(self) -> None:
        """Write everything that a resumed run needs; with several processes, it is alike in all."""
        if not self.processes.main:
            return
        scaler = self.accelerator.scaler
        state = {
            "seen": self.seen,
            "seconds": self.seconds,
            "modules": {name: net.state_dict() for name, net in self.modules.items()},
            "optimizers": {name: each.state_dict() for name, each in self.optimizers.items()},
            "scaler": scaler.state_dict() if scaler else {},
            "average": self.average.state(),
            "log": self.log.state(),
            "course": self.course.state(),
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
        for schedule in self.schedules:
            schedule.last_epoch = self.seen // self.config.batch_size
        self.log.restore(state["log"], self.accelerator.device)
        self.course.restore(state["course"])

    def finish(self) -> dict[str, Any]:
        """Leave the averaged, unwrapped networks with the learner and return the metrics."""
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


class Average:
    """Averages parameters and buffers of networks; switched off, it is the weights themselves.

    The decay warms up as (1 + t) / (10 + t), so that a short run forgets its random start.
    """

    def __init__(self, nets: Sequence[nn.Module], decay: float):
        self._nets, self._decay = nn.ModuleList(nets), decay
        self._model: AveragedModel | None = None
        if decay:
            self._model = AveragedModel(self._nets, multi_avg_fn=self._move, use_buffers=True)
            # The random start is the average of no step, not absent: the first step does not
            # replace it, but moves it.
            self._model.n_averaged.fill_(1)

    def _move(self, averaged: Any, live: Any, _: Any) -> None:
        """Move lists of tensors of one type, as `AveragedModel` asks."""
        assert self._model is not None
        steps = int(self._model.n_averaged)  # lies on the CPU: no wait for the device
        decay = min(self._decay, (1 + steps) / (10 + steps))
        if averaged[0].is_floating_point():
            torch._foreach_lerp_(averaged, live, 1.0 - decay)  # pyright: ignore
        else:  # batch norm's counters
            torch._foreach_copy_(averaged, live)  # pyright: ignore

    def update(self) -> None:
        """Move the average towards the weights after a step."""
        if self._model is not None:
            self._model.update_parameters(self._nets)

    def apply(self) -> None:
        """Put the average into the networks for good."""
        if self._model is not None:
            self._nets.load_state_dict(self._model.module.state_dict())

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Put the average into the networks, in evaluation mode, for the length of a block."""
        kept = {key: value.detach().clone() for key, value in self._nets.state_dict().items()}
        self.apply()
        self._nets.eval()
        try:
            yield
        finally:
            self._nets.load_state_dict(kept)
            self._nets.train()

    def state(self) -> dict[str, Tensor]:
        """Return what `restore` needs."""
        return {} if self._model is None else dict(self._model.state_dict())

    def restore(self, state: dict[str, Tensor]) -> None:
        """Continue from a saved state."""
        if self._model is not None:
            self._model.load_state_dict(state)


def resolve_precision(precision: str, device: str) -> str:
    """Return what `auto` stands for on a device, or the precision named."""
    if precision == "fp16" and device == "cpu":  # it would train in full precision and not say so
        raise RacinesError("training.precision: fp16 needs a CUDA device; use bf16, fp32 or auto")
    if precision != "auto":
        return precision
    if device == "cpu":
        return "bf16" if torch.cpu._is_amx_tile_supported() else "fp32"
    return "bf16" if torch.cuda.is_bf16_supported() else "fp32"


def _accelerator(config: Training, run: Run) -> "Accelerator":
    needed("accelerate", "training")
    from accelerate import Accelerator
    from accelerate.state import AcceleratorState

    # Accelerate keeps one state a process and refuses a second run with another precision.
    AcceleratorState._reset_state(reset_partial_state=True)
    precision = resolve_precision(config.precision, run.device)
    if run.device.startswith("cuda:"):
        torch.cuda.set_device(run.device)  # accelerate takes the current one
    mixed = "no" if precision == "fp32" else precision
    if config.compile:
        check_compiler(run.device, "training.compile")
    compiled = "inductor" if config.compile else "no"  # whatever accelerate's environment says
    try:
        return Accelerator(cpu=run.device == "cpu", mixed_precision=mixed, dynamo_backend=compiled)
    except ValueError as error:  # a device without bfloat16
        raise RacinesError(f"{mixed}: {error}; train in fp32 (bf16: false)") from error
