"""Distillation of the grader: the student learns what the teacher says, not what is true.

Soft labels after Hinton et al., Distilling the Knowledge in a Neural Network (2015); teacher and
student look at the same variant of a frame, as in Beyer et al., Knowledge Distillation: A Good
Teacher Is Patient and Consistent (2022). Order, variants and rates are functions of (seed, step).
"""

import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.optim import AdamW, Optimizer

from racines_data.errors import RacinesError
from racines_data.progress import image_counter
from racines_data.randomness import derive
from racines_data.store.frames import FrameStore
from racines_models.devices import resolve_device
from racines_models.judges.grader.calibration import calibrate
from racines_models.judges.grader.evaluation import write_report
from racines_models.judges.grader.loss import learning_rate
from racines_models.judges.grader.model import Grader
from racines_models.judges.grader.training import judge_training
from racines_models.judges.student.labels import ask_teacher, variants
from racines_models.judges.student.model import Student, StudentConfig
from racines_models.judges.student.report import agreement, speed
from racines_models.protocol import Run
from racines_models.provenance import code_version, dataset_card, environment
from racines_models.training.checkpoint import FOLDER, Checkpoint, discard_checkpoint
from racines_models.training.course import Course
from racines_models.training.objective import Update
from racines_models.training.trainer import train

ORDER = 32
"""Random stream of an epoch's order."""


def train_student(
    store: FrameStore, config: StudentConfig, run: Run, teacher: Grader
) -> dict[str, Any]:
    """Distil, calibrate, save into `run.folder`; return the metrics on the test trajectories.

    Raises:
        RacinesError: the train split is empty, the teacher knows other views or sees less than
            the student, or `run.resume` is True and nothing can be resumed.
    """
    teacher.check_labels(store.labels, "the dataset")
    if not len(store.split_indices("train")):
        raise RacinesError("student: the train split is empty; build a dataset with more sweeps")
    if config.input_size > teacher.config.input_size:
        raise RacinesError(
            f"student.input_size {config.input_size}: the teacher's is {teacher.config.input_size}"
        )
    run = replace(run, device=resolve_device(run.device))
    learner = StudentLearner(store, config, run, teacher)
    asked = learner.ask(run)
    settings = judge_training(config, learner.batch_size, learner.steps)
    figures = train(learner, store, settings, run, learner, config.checkpoint_seconds)
    figures["teacher_seconds"] = round(asked, 3)
    student = Student(learner.network, config, run.device, teacher.labels)
    calibrated = {"split": "validation", "frames": calibrate(student, store)}
    made = {"dataset": dataset_card(store), "seed": run.seed, "code": code_version()}
    made["teacher"] = {"architecture": teacher.architecture, "sha256": teacher.sha256}
    student.save(run.folder, calibrated=calibrated, **made)
    made |= {"agreement": agreement(student, teacher, store), "speed": speed(student, teacher)}
    made |= {"training": figures, "environment": environment(str(student.device))}
    metrics = write_report(run.folder, student, store, **made)
    discard_checkpoint(run.folder)
    return metrics


def distillation_loss(logits: Tensor, taught: Tensor, temperature: float) -> Tensor:
    """Return the KL divergence of (B, L) softened logits from the teacher's, times T squared."""
    ours = functional.log_softmax(logits.float() / temperature, -1)
    theirs = functional.log_softmax(taught / temperature, -1)
    divergence = functional.kl_div(ours, theirs, reduction="batchmean", log_target=True)
    return divergence * temperature**2


class StudentLearner(Course):
    """What the trainer needs of the student, and what its teacher says of the frames."""

    name = "student"

    def __init__(self, store: FrameStore, config: StudentConfig, run: Run, teacher: Grader) -> None:
        self.store, self.config, self.seed, self.teacher = store, config, run.seed, teacher
        self.rows, self.device = store.split_indices("train"), run.device
        self.batch_size = min(config.batch_size, len(self.rows))
        self.per_epoch = len(self.rows) // self.batch_size
        self.steps = config.epochs * self.per_epoch
        known = {"config": asdict(config), "seed": run.seed, "data": dataset_card(store)}
        self.identity = {"name": self.name, "teacher": teacher.sha256} | known
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(run.seed)
            self.network = Student.build(config, len(teacher.labels))
        self.network.to(run.device)

    def ask(self, run: Run) -> float:
        """Have the teacher label the frames; return the seconds that it took.

        Answers that a killed run left are not asked again: from the first of them on, the folder
        holds a checkpoint of this very run.
        """
        began, checkpoint = time.perf_counter(), Checkpoint(run.folder, self.identity)
        if checkpoint.read(run.resume) is None:
            discard_checkpoint(run.folder)
            checkpoint.write({"seen": 0, "seconds": 0.0})
        total = len(self.rows) * self.config.variants
        with image_counter("teacher", total, hidden=not run.progress) as advance:
            folder = run.folder / FOLDER / "teacher"
            answers = (self.config, self.config.variants, self.seed, folder, advance)
            self.taught = ask_teacher(self.teacher, self.store, *answers)
        return time.perf_counter() - began

    def modules(self) -> dict[str, nn.Module]:
        """Return the one network."""
        return {"student": self.network}

    def averaged(self) -> tuple[str, ...]:
        """Name it: its weights are averaged."""
        return ("student",)

    def optimizers(self) -> dict[str, Optimizer]:
        """Return its AdamW; `rate` is the whole rate."""
        weights, decay = self.network.parameters(), self.config.weight_decay
        return {"student": AdamW(weights, lr=1.0, weight_decay=decay, fused=True)}

    def rate(self, step: int) -> float:
        """Return the learning rate: one cycle."""
        return learning_rate(self.config.learning_rate, step / self.steps)

    def batches(self, start: int, stop: int) -> Iterator[tuple[Tensor, Tensor]]:
        """Yield places in the train split, and the variant of each; an epoch sees a frame once."""
        first, offset = divmod(start // self.batch_size, self.per_epoch)
        for epoch in range(first, self.config.epochs):
            generator = torch.Generator()
            generator.manual_seed(int(derive(torch.tensor(self.seed), ORDER, epoch)))
            order = torch.randperm(len(self.rows), generator=generator)
            for number in range(offset, self.per_epoch):
                places = order[number * self.batch_size : (number + 1) * self.batch_size]
                yield places, (places + epoch) % self.config.variants
            offset = 0

    def updates(
        self, nets: Mapping[str, nn.Module], batch: tuple[Tensor, Tensor]
    ) -> Iterator[Update]:
        """Yield the one step: towards what the teacher says of the same variants."""
        (places, which), config = batch, self.config
        rows = self.rows[places]
        x = self.teacher.network.normalise(self.store.take(rows).images.to(self.device))
        x = variants(x, rows, which, self.seed, config)
        smaller = x.shape[-1] // config.input_size
        x = functional.avg_pool2d(x, smaller) if smaller > 1 else x
        logits, grade = nets["student"](x)
        taught = self.taught.logits[which, places].to(self.device)
        wanted = self.taught.grades[which, places].to(self.device)
        losses = {
            "view": distillation_loss(logits, taught, config.temperature),
            "grade": functional.smooth_l1_loss(grade, wanted),
        }
        yield Update("student", losses["view"] + config.grade_weight * losses["grade"], losses)
