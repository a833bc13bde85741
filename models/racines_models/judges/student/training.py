"""Distillation of the grader: the student learns what the teacher says, not what is true.

Soft labels after Hinton et al., Distilling the Knowledge in a Neural Network (2015); teacher and
student look at the same variant of a frame, as in Beyer et al., Knowledge Distillation: A Good
Teacher Is Patient and Consistent (2022). Order, variants and rates are functions of (seed, step).
"""

import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from racines_data.errors import RacinesError
from racines_data.progress import image_counter
from racines_data.randomness import derive
from racines_data.store.frames import FrameStore
from racines_models.judges.grader.calibration import calibrate
from racines_models.judges.grader.evaluation import write_report
from racines_models.judges.grader.loss import learning_rate
from racines_models.judges.grader.model import Grader
from racines_models.judges.grader.training import grader_accelerator
from racines_models.judges.student.labels import ask_teacher, variants
from racines_models.judges.student.model import Student, StudentConfig
from racines_models.judges.student.report import agreement, speed
from racines_models.protocol import Run
from racines_models.provenance import code_version, dataset_card, environment
from racines_models.training.checkpoint import FOLDER, Checkpoint, discard_checkpoint
from racines_models.training.log import TrainingLog

ORDER = 32
"""Random stream of an epoch's order."""
LOG_STEPS = 10


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
    training = _Distillation(store, config, run, teacher)
    with training.log:
        training.run()
    student = Student(training.unwrapped(), config, teacher.device.type, teacher.labels)
    calibrated = {"split": "validation", "frames": calibrate(student, store)}
    made = {"dataset": dataset_card(store), "seed": run.seed, "code": code_version()}
    made["teacher"] = {"architecture": teacher.architecture, "sha256": teacher.sha256}
    student.save(run.folder, calibrated=calibrated, **made)
    made |= {"agreement": agreement(student, teacher, store), "speed": speed(student, teacher)}
    made |= {"training": training.figures(), "environment": environment(str(student.device))}
    metrics = write_report(run.folder, student, store, **made)
    discard_checkpoint(run.folder)
    return metrics


def distillation_loss(logits: Tensor, taught: Tensor, temperature: float) -> Tensor:
    """Return the KL divergence of (B, L) softened logits from the teacher's, times T squared."""
    ours = functional.log_softmax(logits.float() / temperature, -1)
    theirs = functional.log_softmax(taught / temperature, -1)
    divergence = functional.kl_div(ours, theirs, reduction="batchmean", log_target=True)
    return divergence * temperature**2


class _Distillation:
    """The state of one run: network, optimizer, the teacher's answers, and how far it has come."""

    def __init__(self, store: FrameStore, config: StudentConfig, run: Run, teacher: Grader):
        self.store, self.config, self.seed, self.teacher = store, config, run.seed, teacher
        self.rows = store.split_indices("train")
        self.batch_size = min(config.batch_size, len(self.rows))
        self.per_epoch = len(self.rows) // self.batch_size
        self.accelerator = grader_accelerator(config.bf16, run.device, "student")
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(run.seed)
            network = Student.build(config, len(teacher.labels))
        self.network = self.accelerator.prepare(network)
        adam = torch.optim.AdamW(
            self.network.parameters(), lr=0.0, weight_decay=config.weight_decay, fused=True
        )
        self.optimizer = self.accelerator.prepare(adam)
        identity = {"config": asdict(config), "seed": run.seed, "data": dataset_card(store)}
        identity["teacher"] = teacher.sha256
        self.checkpoint = Checkpoint(run.folder, identity)
        state = self.checkpoint.read(run.resume)
        self.step: int = state["step"] if state else 0
        self.seconds: float = state["seconds"] if state else 0.0
        self.saved = time.perf_counter()
        self._ask(run, state is None)
        first, stop = (steps * self.batch_size for steps in (self.step, self._steps()))
        self.log = TrainingLog(run.folder, "student", first, stop, run.progress)
        if state:
            self.network.load_state_dict(state["network"])
            self.optimizer.load_state_dict(state["optimizer"])
            self.log.restore(state["log"], self.accelerator.device)

    def _steps(self) -> int:
        return self.config.epochs * self.per_epoch

    def _ask(self, run: Run, anew: bool) -> None:
        if anew:
            # From here on the folder holds answers of this very run: see `SoftLabels`.
            discard_checkpoint(run.folder)
        began, count = time.perf_counter(), self.config.variants
        if anew:
            self._write_checkpoint()
        total = len(self.rows) * count
        with image_counter("teacher", total, hidden=not run.progress) as advance:
            folder = Path(run.folder) / FOLDER / "teacher"
            answers = (self.teacher, self.store, self.config, count, self.seed, folder, advance)
            self.taught = ask_teacher(*answers)
        self.asked = time.perf_counter() - began

    def run(self) -> None:
        """Train from where the checkpoint stood."""
        self.network.train()
        began = time.perf_counter() - self.seconds
        for places, which in self._batches():
            self._update(places, which)
            self.seconds = time.perf_counter() - began
            if self.step % LOG_STEPS == 0 or self.step % self.per_epoch == 0:
                self.log.row(self.step * self.batch_size)
            if time.perf_counter() - self.saved >= self.config.checkpoint_seconds:
                self._write_checkpoint()

    def _batches(self) -> Iterator[tuple[Tensor, Tensor]]:
        """Yield places in the train split, and the variant of each; an epoch sees a frame once."""
        first, offset = divmod(self.step, self.per_epoch)
        for epoch in range(first, self.config.epochs):
            generator = torch.Generator()
            generator.manual_seed(int(derive(torch.tensor(self.seed), ORDER, epoch)))
            order = torch.randperm(len(self.rows), generator=generator)
            for number in range(offset, self.per_epoch):
                places = order[number * self.batch_size : (number + 1) * self.batch_size]
                yield places, (places + epoch) % self.config.variants
            offset = 0

    def _update(self, places: Tensor, which: Tensor) -> None:
        device, config = self.accelerator.device, self.config
        rows = self.rows[places]
        x = self.teacher.network.normalise(self.store.take(rows).images.to(device))
        x = variants(x, rows, which, self.seed, config)
        smaller = x.shape[-1] // config.input_size
        x = functional.avg_pool2d(x, smaller) if smaller > 1 else x
        logits, grade = self.network(x)
        taught = self.taught.logits[which, places].to(device)
        wanted = self.taught.grades[which, places].to(device)
        losses = {
            "view": distillation_loss(logits, taught, config.temperature),
            "grade": functional.smooth_l1_loss(grade, wanted),
        }
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate(config.learning_rate, self.step / self._steps())
        self.accelerator.backward(losses["view"] + config.grade_weight * losses["grade"])
        self.optimizer.step()
        self.optimizer.zero_grad()
        self.step += 1
        self.log.add(losses)

    def _write_checkpoint(self) -> None:
        self.saved = time.perf_counter()
        log = self.log.state() if self.step else {"sums": {}, "steps": 0, "last": {}}
        state = {"step": self.step, "seconds": self.seconds, "log": log}
        state |= {"network": self.network.state_dict(), "optimizer": self.optimizer.state_dict()}
        self.checkpoint.write(state)

    def unwrapped(self) -> Any:
        """Return the network as it was before accelerate wrapped its precision around it."""
        return self.accelerator.unwrap_model(self.network, keep_fp32_wrapper=False)

    def figures(self) -> dict[str, Any]:
        """Return what the run took, and the losses of the last row of its curves."""
        images = self.step * self.batch_size
        return {
            "images": images,
            "steps": self.step,
            "seconds": round(self.seconds, 3),
            "teacher_seconds": round(self.asked, 3),
            "images_per_second": round(images / max(self.seconds, 1e-9), 1),
            "losses": self.log.last,
        }
