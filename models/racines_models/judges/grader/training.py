"""Training of the grader: views first, then the transfer to grades.

Batches, augmentation and learning rates are functions of (seed, stage, step) alone, so a run that
was killed and resumed on the same machine ends in the same weights.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import islice
from typing import Any, ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.optim import AdamW, Optimizer

from racines_data.errors import RacinesError
from racines_data.randomness import derive
from racines_data.store.frames import Batch, FrameStore
from racines_models.devices import has_bfloat16, resolve_device
from racines_models.judges.grader.evaluation import write_report
from racines_models.judges.grader.model import Grader, GraderConfig
from racines_models.judges.grader.report import calibrate
from racines_models.protocol import Run
from racines_models.provenance import code_version, dataset_card, environment
from racines_models.training.augmentation import augment, spoil, strengthen
from racines_models.training.checkpoint import discard_checkpoint
from racines_models.training.objective import Course, Training, Update
from racines_models.training.trainer import train

ORDER, NOISE = 21, 22
"""Random streams: the order of an epoch, the augmentation of a step."""
LOG_STEPS = 10
WARM_UP = 0.1
"""Share of a stage in which the learning rate rises."""


def train_grader(
    store: FrameStore, config: GraderConfig, run: Run, kind: type[Grader] = Grader
) -> dict[str, Any]:
    """Train, save into `run.folder`, and return the metrics on the test trajectories.

    `kind` is the grader's class, whose `Config` the config is.

    Raises:
        RacinesError: the data have no views, or `run.resume` is True and nothing can be resumed.
    """
    rows = store.split_indices("train")
    if not len(rows):
        raise RacinesError("grader: the train split is empty; build a dataset with more sweeps")
    if not bool((store.views[rows] >= 0).any()):
        raise RacinesError(
            f"grader: no frame of this dataset (source {store.manifest['source']}) has a view; "
            "train on a labelled source, such as: racines data build --source phantom"
        )
    run = replace(run, device=resolve_device(run.device))
    learner = GraderLearner(store, config, run, kind)
    return learner.teach(run, **learner.begun)


class JudgeLearner(Course):
    """What the trainer needs of a network that views and grades: the grader's, or its student's."""

    name: ClassVar[str]
    judge: type[Grader]
    batch_size: int
    steps: int

    def __init__(
        self, store: FrameStore, config: Any, run: Run, labels: Sequence[str], **identity: Any
    ) -> None:
        self.store, self.config, self.labels = store, config, labels
        self.seed, self.device = run.seed, run.device
        known = {"config": asdict(config), "seed": run.seed, "data": dataset_card(store)}
        self.identity = {"name": self.name} | identity | known
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(run.seed)
            self.network = self.judge.build(config, len(labels))
        self.network.to(run.device)

    def modules(self) -> dict[str, nn.Module]:
        """Return the one network."""
        return {self.name: self.network}

    def averaged(self) -> tuple[str, ...]:
        """Name it: its weights are averaged."""
        return (self.name,)

    def teach(self, run: Run, **provenance: Any) -> dict[str, Any]:
        """Train, calibrate, save with the provenance into `run.folder`; return the metrics."""
        settings = Training(
            images=self.steps * self.batch_size,
            batch_size=self.batch_size,
            precision="bf16" if self.config.bf16 and has_bfloat16(run.device) else "fp32",
            ema=self.config.ema,
            log_every=LOG_STEPS * self.batch_size,
            checkpoint_every=self.batch_size,
        )
        learner: Any = self  # whole in its subclasses, which have optimizers and updates
        figures = train(learner, self.store, settings, run, self, self.config.checkpoint_seconds)
        judge = self.judge(self.network, self.config, run.device, self.labels)
        calibrated = {"split": "validation", "frames": calibrate(judge, self.store)}
        made = {"dataset": dataset_card(self.store), "seed": run.seed, "code": code_version()}
        made |= provenance
        judge.save(run.folder, calibrated=calibrated, **made)
        made |= self.beside(judge, figures)
        made |= {"training": figures, "environment": environment(str(judge.device))}
        metrics = write_report(run.folder, judge, self.store, **made)
        discard_checkpoint(run.folder)
        return metrics

    def beside(self, judge: Grader, training: dict[str, Any]) -> dict[str, Any]:
        """Return what else the metrics hold; may add to the figures of the training."""
        return {}


class GraderLearner(JudgeLearner):
    """The grader's two stages, an optimizer each, one after the other."""

    name = "grader"

    def __init__(
        self, store: FrameStore, config: GraderConfig, run: Run, kind: type[Grader] = Grader
    ) -> None:
        self.judge = kind
        super().__init__(store, config, run, store.labels)
        self.begun = kind.begin(self.network, config)
        self.identity |= self.begun
        self.batch_size = config.batch_size
        self.steps_per_epoch = max(len(store.split_indices("train")) // config.batch_size, 1)
        self.stages = {"views": config.view_stage, "grades": config.grade_stage}
        self.steps = sum(each.epochs for each in self.stages.values()) * self.steps_per_epoch
        self.weights = class_weights(store, config.class_balance).to(run.device)

    def optimizers(self) -> dict[str, Optimizer]:
        """Return an AdamW a stage; the rates are multiples of the stage's (see `rate`)."""
        heads, made = (self.network.view_head, self.network.grade_head), {}
        groups = [{"params": list(head.parameters())} for head in heads]
        for name, stage in self.stages.items():
            encoder = {"params": list(self.network.encoder.parameters()), "lr": stage.encoder_rate}
            decay = self.config.weight_decay
            made[name] = AdamW([encoder, *groups], lr=1.0, weight_decay=decay, fused=True)
        return made

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
        step = start // self.batch_size
        while step < stop // self.batch_size:
            name, number = self._place(step)
            epoch, offset = divmod(number, self.steps_per_epoch)
            drawn = derive(torch.tensor(self.seed), ORDER, list(self.stages).index(name), epoch)
            batches = self.store.batches("train", self.batch_size, seed=int(drawn))
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
        seeds, images = seeds.to(self.device), frames.images.to(self.device)
        x = augment(self.network.normalise(images), seeds, self.config)
        views, grades = frames.views.to(self.device), frames.grades.to(self.device)
        if self.config.strong.parts:
            x, _ = strengthen(x, seeds, self.config.strong)
            x, spoilt = spoil(x, seeds, self.config.strong)
            views = torch.where(spoilt, len(self.labels) - 1, views)
            grades = torch.where(spoilt, torch.nan, grades)
        logits, grade = nets["grader"](x)
        losses = {
            "view": view_loss(logits, views, self.weights),
            "grade": grade_loss(grade, grades),
        }
        loss = stage.view_weight * losses["view"] + stage.grade_weight * losses["grade"]
        yield Update(name, loss, losses)


def view_loss(logits: Tensor, views: Tensor, weights: Tensor) -> Tensor:
    """Return the weighted cross-entropy of (B, L) logits over the frames with a view (not -1)."""
    loss = functional.cross_entropy(logits, views, weights, ignore_index=-1, reduction="sum")
    total = weights[views.clamp_min(0)].mul(views >= 0).sum()
    return loss / total.clamp_min(1e-6)


def grade_loss(grade: Tensor, target: Tensor) -> Tensor:
    """Return the smooth L1 loss of (B,) grades over the frames with a grade (not NaN)."""
    present = target.isfinite()
    error = functional.smooth_l1_loss(grade, target.nan_to_num(0.0), reduction="none", beta=1.0)
    return (error * present).sum() / present.sum().clamp_min(1)


def class_weights(store: FrameStore, power: float) -> Tensor:
    """Return (labels,) weights, the train frequencies to minus `power`, of mean one over frames."""
    views = store.views[store.split_indices("train")]
    count = torch.bincount(views[views >= 0], minlength=len(store.labels)).float()
    weights = count.clamp_min(1.0).pow(-power)
    return weights * count.sum() / (weights * count).sum()


def learning_rate(peak: float, progress: float) -> float:
    """Rise linearly to the peak, then fall as a cosine to zero; progress in 0-1."""
    if progress < WARM_UP:
        return peak * (progress + 1e-3) / (WARM_UP + 1e-3)
    return peak * 0.5 * (1.0 + math.cos(math.pi * (progress - WARM_UP) / (1.0 - WARM_UP)))
