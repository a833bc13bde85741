"""Training of the grader: views first, then the transfer to grades.

Batches, augmentation and learning rates are functions of (seed, stage, step) alone, so a run that
was killed and resumed on the same machine ends in the same weights.
"""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from itertools import islice
from typing import Any

import torch
from torch import nn
from torch.optim import AdamW, Optimizer

from racines_data.errors import RacinesError
from racines_data.randomness import derive
from racines_data.store.frames import Batch, FrameStore
from racines_models.devices import resolve_device
from racines_models.judges.grader.calibration import calibrate
from racines_models.judges.grader.evaluation import write_report
from racines_models.judges.grader.loss import class_weights, grade_loss, learning_rate, view_loss
from racines_models.judges.grader.model import Grader, GraderConfig, GraderNetwork
from racines_models.protocol import Run
from racines_models.provenance import code_version, dataset_card, environment
from racines_models.training.augmentation import augment
from racines_models.training.checkpoint import discard_checkpoint
from racines_models.training.course import Course
from racines_models.training.objective import Training, Update
from racines_models.training.trainer import train

ORDER, NOISE = 21, 22
"""Random streams: the order of an epoch, the augmentation of a step."""
LOG_STEPS = 10


def train_grader(store: FrameStore, config: GraderConfig, run: Run) -> dict[str, Any]:
    """Train, save into `run.folder`, and return the metrics on the test trajectories.

    Raises:
        RacinesError: the data have no views, or `run.resume` is True and nothing can be resumed.
    """
    _check_labels(store)
    run = replace(run, device=resolve_device(run.device))
    learner = GraderLearner(store, config, run)
    settings = judge_training(config, config.batch_size, learner.steps)
    figures = train(learner, store, settings, run, learner, config.checkpoint_seconds)
    grader = Grader(learner.network, config, run.device, store.labels)
    calibrated = {"split": "validation", "frames": calibrate(grader, store)}
    made = {"dataset": dataset_card(store), "seed": run.seed, "code": code_version()}
    grader.save(run.folder, calibrated=calibrated, **made)
    made |= {"training": figures, "environment": environment(str(grader.device))}
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


class GraderLearner(Course):
    """What the trainer needs of the grader: two stages, an optimizer each, one after the other."""

    name = "grader"

    def __init__(self, store: FrameStore, config: GraderConfig, run: Run) -> None:
        self.store, self.config, self.seed, self.device = store, config, run.seed, run.device
        frames = len(store.split_indices("train"))
        self.steps_per_epoch = max(frames // config.batch_size, 1)
        self.stages = {"views": config.view_stage, "grades": config.grade_stage}
        known = {"config": asdict(config), "seed": run.seed, "data": dataset_card(store)}
        self.identity = {"name": self.name} | known
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(run.seed)
            self.network = GraderNetwork(config.input_size, config.width, len(store.labels))
        self.network.to(run.device)
        self.weights = class_weights(store, config.class_balance).to(run.device)

    @property
    def steps(self) -> int:
        """Steps of both stages."""
        return sum(stage.epochs for stage in self.stages.values()) * self.steps_per_epoch

    def modules(self) -> dict[str, nn.Module]:
        """Return the one network."""
        return {"grader": self.network}

    def averaged(self) -> tuple[str, ...]:
        """Name it: its weights are averaged."""
        return ("grader",)

    def optimizers(self) -> dict[str, Optimizer]:
        """Return an AdamW a stage; the rates are multiples of the stage's (see `rate`)."""
        heads = [{"params": list(head.parameters())} for head in self._heads()]
        made = {}
        for name, stage in self.stages.items():
            encoder = {"params": list(self.network.encoder.parameters()), "lr": stage.encoder_rate}
            decay = self.config.weight_decay
            made[name] = AdamW([encoder, *heads], lr=1.0, weight_decay=decay, fused=True)
        return made

    def _heads(self) -> tuple[nn.Module, nn.Module]:
        return self.network.view_head, self.network.grade_head

    def _place(self, step: int) -> tuple[str, int]:
        """Return the stage of a step, and which of its steps it is."""
        first = self.stages["views"].epochs * self.steps_per_epoch
        return ("views", step) if step < first else ("grades", step - first)

    def rate(self, step: int) -> float:
        """Return the learning rate of the heads: one cycle a stage."""
        name, number = self._place(min(step, self.steps - 1))
        stage = self.stages[name]
        return learning_rate(stage.learning_rate, number / (stage.epochs * self.steps_per_epoch))

    def batches(self, start: int, stop: int) -> Iterator[tuple[int, Batch]]:
        """Yield each step's number and frames; the order is drawn anew every epoch."""
        step = start // self.config.batch_size
        while step < stop // self.config.batch_size:
            name, number = self._place(step)
            epoch, offset = divmod(number, self.steps_per_epoch)
            drawn = derive(torch.tensor(self.seed), ORDER, list(self.stages).index(name), epoch)
            batches = self.store.batches("train", self.config.batch_size, seed=int(drawn))
            for batch in islice(batches, offset, self.steps_per_epoch):
                yield step, batch
                step += 1

    def updates(self, nets: Mapping[str, nn.Module], batch: tuple[int, Batch]) -> Iterator[Update]:
        """Yield the one step of the stage under way."""
        step, frames = batch
        name, _ = self._place(step)
        stage = self.stages[name]
        frozen = stage.encoder_rate == 0.0
        self.network.encoder.requires_grad_(not frozen).train(not frozen)
        seeds = derive(torch.tensor(self.seed), NOISE, step, torch.arange(len(frames.images)))
        x = self.network.normalise(frames.images.to(self.device))
        logits, grade = nets["grader"](augment(x, seeds.to(self.device), self.config))
        losses = {
            "view": view_loss(logits, frames.views.to(self.device), self.weights),
            "grade": grade_loss(grade, frames.grades.to(self.device)),
        }
        loss = stage.view_weight * losses["view"] + stage.grade_weight * losses["grade"]
        yield Update(name, loss, losses)


def judge_training(config: Any, batch_size: int, steps: int) -> Training:
    """Return the trainer's settings of a grader's or student's config, for so many steps."""
    return Training(
        images=steps * batch_size,
        batch_size=batch_size,
        precision="bf16" if config.bf16 else "fp32",
        ema=config.ema,
        log_every=LOG_STEPS * batch_size,
        checkpoint_every=batch_size,
    )
