"""Training of the grader: views first, then the transfer to grades.

Batches, augmentation and learning rates are functions of (seed, stage, step) alone, so a run that
was killed and resumed on the same machine ends in the same weights.
"""

import time
from collections.abc import Iterator
from dataclasses import asdict
from itertools import islice
from typing import Any

import torch
from accelerate import Accelerator
from accelerate.state import AcceleratorState

from racines_data.errors import RacinesError
from racines_data.randomness import derive
from racines_data.store.frames import Batch, FrameStore
from racines_models.devices import resolve_device
from racines_models.judges.grader.calibration import calibrate
from racines_models.judges.grader.evaluation import write_report
from racines_models.judges.grader.loss import class_weights, grade_loss, learning_rate, view_loss
from racines_models.judges.grader.model import Grader, GraderConfig, GraderNetwork, StageConfig
from racines_models.protocol import Run
from racines_models.provenance import code_version, dataset_card, environment
from racines_models.training.augmentation import augment
from racines_models.training.checkpoint import Checkpoint, discard_checkpoint
from racines_models.training.log import TrainingLog

ORDER, NOISE = 21, 22
"""Random streams: the order of an epoch, the augmentation of a step."""
LOG_STEPS = 10


def train_grader(store: FrameStore, config: GraderConfig, run: Run) -> dict[str, Any]:
    """Train, save into `run.folder`, and return the metrics on the test trajectories.

    Raises:
        RacinesError: the data have no views, or `run.resume` is True and nothing can be resumed.
    """
    _check_labels(store)
    training = _Training(store, config, run)
    with training.log:
        training.run()
    device = training.accelerator.device.type
    grader = Grader(training.unwrapped(), config, device, store.labels)
    calibrated = {"split": "validation", "frames": calibrate(grader, store)}
    made = {"dataset": dataset_card(store), "seed": run.seed, "code": code_version()}
    grader.save(run.folder, calibrated=calibrated, **made)
    made |= {"training": training.figures(), "environment": environment(str(grader.device))}
    metrics = write_report(run.folder, grader, store, **made)
    discard_checkpoint(run.folder)
    return metrics


def _check_labels(store: FrameStore) -> None:
    rows = store.split_indices("train")
    if not len(rows):
        raise RacinesError("grader: the train split is empty; build a dataset with more sweeps")
    if not bool((store.views[rows] >= 0).any()):
        raise RacinesError(
            f"grader: no frame of this dataset (source {store.manifest['source']}) has a view; "
            "train on a labelled source, such as: racines data build --source phantom"
        )


class _Training:
    """The state of one run: network, optimizer of the stage, and how far it has come."""

    def __init__(self, store: FrameStore, config: GraderConfig, run: Run) -> None:
        self.store, self.config, self.seed = store, config, run.seed
        self.stages = (config.view_stage, config.grade_stage)
        frames = len(store.split_indices("train"))
        self.steps_per_epoch = max(frames // config.batch_size, 1)
        self.accelerator = grader_accelerator(config.bf16, run.device, "grader")
        self.weights = class_weights(store, config.class_balance).to(self.accelerator.device)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(run.seed)
            network = GraderNetwork(config.input_size, config.width, len(store.labels))
            self.network = self.accelerator.prepare(network)
        identity = {"config": asdict(config), "seed": run.seed, "data": dataset_card(store)}
        self.checkpoint = Checkpoint(run.folder, identity)
        self.state = self.checkpoint.read(run.resume)
        self.step: int = self.state["step"] if self.state else 0
        self.seconds: float = self.state["seconds"] if self.state else 0.0
        self.saved = time.perf_counter()
        total = sum(stage.epochs for stage in self.stages) * self.steps_per_epoch
        size = config.batch_size
        self.log = TrainingLog(run.folder, "grader", self.step * size, total * size, run.progress)
        if self.state:
            self.network.load_state_dict(self.state["network"])
            self.log.restore(self.state["log"], self.accelerator.device)

    def run(self) -> None:
        """Train the stages in turn, from where the checkpoint stood."""
        began, first = time.perf_counter() - self.seconds, 0
        for index, stage in enumerate(self.stages):
            steps = stage.epochs * self.steps_per_epoch
            if self.step < first + steps:
                self._begin(index, stage)
                for batch in self._batches(index, stage, self.step - first):
                    self._update(stage, batch, (self.step - first) / steps)
                    self.seconds = time.perf_counter() - began
                    self._housekeeping(index)
            first += steps

    def _begin(self, index: int, stage: StageConfig) -> None:
        self.network.train()
        frozen = stage.encoder_rate == 0.0
        self.network.encoder.requires_grad_(not frozen).train(not frozen)
        groups = [
            {"params": list(self.network.encoder.parameters()), "scale": stage.encoder_rate},
            {"params": list(self.network.view_head.parameters()), "scale": 1.0},
            {"params": list(self.network.grade_head.parameters()), "scale": 1.0},
        ]
        adam = torch.optim.AdamW(groups, lr=0.0, weight_decay=self.config.weight_decay, fused=True)
        self.optimizer = self.accelerator.prepare(adam)
        if self.state and self.state["stage"] == index:
            self.optimizer.load_state_dict(self.state["optimizer"])

    def _batches(self, index: int, stage: StageConfig, start: int) -> Iterator[Batch]:
        epoch, offset = divmod(start, self.steps_per_epoch)
        for number in range(epoch, stage.epochs):
            order = int(derive(torch.tensor(self.seed), ORDER, index, number))
            batches = self.store.batches("train", self.config.batch_size, seed=order)
            yield from islice(batches, offset, self.steps_per_epoch)
            offset = 0

    def _update(self, stage: StageConfig, batch: Batch, progress: float) -> None:
        device = self.accelerator.device
        seeds = derive(torch.tensor(self.seed), NOISE, self.step, torch.arange(len(batch.images)))
        x = self.network.normalise(batch.images.to(device))
        logits, grade = self.network(augment(x, seeds.to(device), self.config))
        losses = {
            "view": view_loss(logits, batch.views.to(device), self.weights),
            "grade": grade_loss(grade, batch.grades.to(device)),
        }
        for group in self.optimizer.param_groups:
            group["lr"] = group["scale"] * learning_rate(stage.learning_rate, progress)
        loss = stage.view_weight * losses["view"] + stage.grade_weight * losses["grade"]
        self.accelerator.backward(loss)
        self.optimizer.step()
        self.optimizer.zero_grad()
        self.step += 1
        self.log.add(losses)

    def _housekeeping(self, index: int) -> None:
        if self.step % LOG_STEPS == 0 or self.step % self.steps_per_epoch == 0:
            self.log.row(self.step * self.config.batch_size)
        if time.perf_counter() - self.saved < self.config.checkpoint_seconds:
            return
        self.saved = time.perf_counter()
        state = {"step": self.step, "seconds": self.seconds, "stage": index}
        state |= {"network": self.network.state_dict(), "log": self.log.state()}
        self.checkpoint.write(state | {"optimizer": self.optimizer.state_dict()})

    def unwrapped(self) -> GraderNetwork:
        """Return the network as it was before accelerate wrapped its precision around it."""
        return self.accelerator.unwrap_model(self.network, keep_fp32_wrapper=False)

    def figures(self) -> dict[str, Any]:
        """Return what the run took, and the losses of the last row of its curves."""
        images = self.step * self.config.batch_size
        return {
            "images": images,
            "steps": self.step,
            "seconds": round(self.seconds, 3),
            "images_per_second": round(images / max(self.seconds, 1e-9), 1),
            "losses": self.log.last,
        }


def grader_accelerator(bf16: bool, device: str, section: str) -> Accelerator:
    """Return an accelerator of one process for the settings of a params section.

    Raises:
        RacinesError: the device has no bfloat16, or several processes were launched.
    """
    device = resolve_device(device)
    # Accelerate keeps one state a process and refuses a second run with another precision.
    AcceleratorState._reset_state(reset_partial_state=True)
    try:
        accelerator = Accelerator(cpu=device == "cpu", mixed_precision="bf16" if bf16 else "no")
    except ValueError as error:
        raise RacinesError(f"{section}.bf16: {error}; set it to false") from error
    if accelerator.num_processes > 1:
        raise RacinesError("training runs in one process: start it without accelerate launch")
    return accelerator
