"""Distillation of the grader: the student learns what the teacher says, not what is true.

Soft labels after Hinton et al., Distilling the Knowledge in a Neural Network (2015); teacher and
student look at the same variant of a frame, as in Beyer et al., Knowledge Distillation: A Good
Teacher Is Patient and Consistent (2022). The teacher is asked once, before, and its answers are
kept on disk: a variant is a function of (seed, frame, variant), so that the student, who looks at
it epochs later, sees what the teacher saw. Order and rates are functions of (seed, step).
"""

import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn
from torch.nn import functional
from torch.optim import AdamW, Optimizer

from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE
from racines_data.progress import image_counter
from racines_data.randomness import derive, uniform
from racines_data.store.frames import FrameStore
from racines_models.devices import resolve_device
from racines_models.judges.grader.model import Grader
from racines_models.judges.grader.report import compare
from racines_models.judges.grader.training import JudgeLearner, learning_rate
from racines_models.judges.student.model import Student, StudentConfig
from racines_models.protocol import Run
from racines_models.sample import Progress
from racines_models.training.augmentation import Augmentation, augment
from racines_models.training.checkpoint import FOLDER, Checkpoint, discard_checkpoint
from racines_models.training.objective import Update
from racines_models.weights import save_weights

VARIANT, ORDER = 31, 32
"""Random streams: the variants, and an epoch's order."""
CHUNK = 4096
"""Frames of one file of answers: what a killed run has to ask again."""
ASKED = 256
"""Frames that the teacher is asked of at once."""
BATCH = 64
"""Images of a timed call."""
ROUNDS = 15
"""Timed calls of each; the best counts, since what else the machine does only slows."""


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
    learner.ask(run)
    named = {"architecture": teacher.architecture, "sha256": teacher.sha256}
    return learner.teach(run, teacher=named)


def distillation_loss(logits: Tensor, taught: Tensor, temperature: float) -> Tensor:
    """Return the KL divergence of (B, L) softened logits from the teacher's, times T squared."""
    ours = functional.log_softmax(logits.float() / temperature, -1)
    theirs = functional.log_softmax(taught / temperature, -1)
    divergence = functional.kl_div(ours, theirs, reduction="batchmean", log_target=True)
    return divergence * temperature**2


class StudentLearner(JudgeLearner):
    """The student under its teacher, and what that says of the frames."""

    name = "student"
    judge = Student

    def __init__(self, store: FrameStore, config: StudentConfig, run: Run, teacher: Grader) -> None:
        super().__init__(store, config, run, teacher.labels, teacher=teacher.sha256)
        self.teacher, self.rows = teacher, store.split_indices("train")
        self.batch_size = min(config.batch_size, len(self.rows))
        self.per_epoch = len(self.rows) // self.batch_size
        self.steps = config.epochs * self.per_epoch

    def ask(self, run: Run) -> None:
        """Have the teacher label the frames.

        Answers that a killed run left are not asked again: from the first of them on, the folder
        holds a checkpoint of this very run.
        """
        began, checkpoint = time.perf_counter(), Checkpoint(run.folder, self.identity)
        if checkpoint.read(run.resume) is None:
            discard_checkpoint(run.folder)
            checkpoint.write({"seen": 0, "seconds": 0.0})
        total = len(self.rows) * self.config.variants
        with image_counter("teacher", total, hidden=not run.progress) as advance:
            self.taught = self.answers(run.folder / FOLDER / "teacher", advance)
        self.asked = time.perf_counter() - began

    def answers(self, folder: Path, progress: Progress) -> tuple[Tensor, Tensor]:
        """Return the teacher's (V, N, L) logits and (V, N) grades of N frames in V variants.

        What `folder` has already is not asked again: it must belong to this very run.
        """
        parts, count = [], self.config.variants
        for variant, (number, chunk) in product(range(count), enumerate(self.rows.split(CHUNK))):
            path = folder / f"{variant:02d}-{number:04d}.safetensors"
            try:
                answers = load_file(path)
            except (SafetensorError, OSError):  # not asked yet, or damaged
                answers = self.ask_of(chunk, variant)
                save_weights(path, answers)
            parts.append(answers)
            progress(len(chunk))
        logits, grades = (torch.cat([part[key] for part in parts]) for key in ("logits", "grades"))
        return logits.view(count, len(self.rows), -1), grades.view(count, -1)

    @torch.inference_mode()
    def ask_of(self, rows: Tensor, variant: int) -> dict[str, Tensor]:
        """Return the teacher's `logits` and `grades` of one variant of some frames."""
        parts, teacher = [], self.teacher
        for batch in rows.split(ASKED):
            x = teacher.network.normalise(self.store.take(batch).images.to(teacher.device))
            x = variants(x, batch, torch.full_like(batch, variant), self.seed, self.config)
            parts.append(teacher.answer(x))
        logits, grades = (torch.cat([part[i] for part in parts]).cpu() for i in (0, 1))
        return {"logits": logits, "grades": grades}

    def beside(self, judge: Grader, training: dict[str, Any]) -> dict[str, Any]:
        """Return how the student agrees with its teacher, and how quick both are."""
        training["teacher_seconds"] = round(self.asked, 3)
        compared = agreement(judge, self.teacher, self.store)
        return {"agreement": compared, "speed": speed(judge, self.teacher)}

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
        taught, wanted = (each[which, places].to(self.device) for each in self.taught)
        losses = {
            "view": distillation_loss(logits, taught, config.temperature),
            "grade": functional.smooth_l1_loss(grade, wanted),
        }
        yield Update("student", losses["view"] + config.grade_weight * losses["grade"], losses)


def variants(
    x: Tensor, rows: Tensor, which: Tensor, seed: int, augmentation: Augmentation
) -> Tensor:
    """Return the variants that `which` (B,) names of (B, 1, S, S) images as the teacher takes them.

    `rows` (B,) are those of the frames in the store; variant 0 leaves the image as it is.
    """
    seeds = derive(derive(torch.tensor(seed), VARIANT, rows), which).to(x.device)
    varied = augment(x, seeds, augmentation)
    return torch.where(which.to(x.device).view(-1, 1, 1, 1) == 0, x, varied)


def agreement(
    student: Grader, teacher: Grader, store: FrameStore, split: str = "test"
) -> dict[str, Any]:
    """Compare the answers on a split.

    Returns:
        `view`: share of frames with the teacher's label; `grade_mae`: mean absolute difference of
        the grades on frames that the teacher calls a view; each with value, low, high, n.
    """
    rows = store.split_indices(split)
    images, units = store.take(rows).images, store.units(rows)
    ours, theirs = student.judge(images)[:2], teacher.judge(images)[:2]
    compared = compare(*ours, *theirs, len(teacher.labels) - 1)
    view = compared["view_agreement"]._replace(rule="the student's label is the teacher's")
    told: dict[str, Any] = {"split": split, "view": view.mean(units)}
    if grade := compared.get("grade_error"):
        rule = "mean absolute difference, frames that the teacher calls a view"
        told["grade_mae"] = grade._replace(rule=rule).mean(units)
    return told


def speed(student: Grader, teacher: Grader) -> dict[str, Any]:
    """Time `probabilities_and_grade` of both in turns, batches of 64 on their device.

    Returns:
        `student` and `teacher` in images/s, their `ratio`, `batch_size`, `threads`, `device`.
    """
    pixels = uniform(torch.arange(BATCH), IMAGE_SIZE**2).view(BATCH, IMAGE_SIZE, IMAGE_SIZE)
    images = (pixels * 255).to(torch.uint8).to(teacher.device)
    graders, best = {"student": student, "teacher": teacher}, {}
    for turn in range(ROUNDS + 2):
        for name, grader in graders.items():
            began = time.perf_counter()
            grader.probabilities_and_grade(images)[1].cpu()  # waits for the device
            seconds = time.perf_counter() - began
            if turn >= 2:  # the first calls set up kernels and memory
                best[name] = min(best.get(name, seconds), seconds)
    rates = {name: round(BATCH / seconds, 1) for name, seconds in best.items()}
    ratio = {"ratio": round(best["teacher"] / best["student"], 2), "rounds": ROUNDS}
    how = {"threads": torch.get_num_threads(), "device": str(teacher.device)}
    return rates | ratio | {"batch_size": BATCH} | how
