"""How a student compares with its teacher: the same answers, in how much less time."""

import time
from typing import Any

import torch

from racines_data.imaging import IMAGE_SIZE
from racines_data.randomness import uniform
from racines_data.store.frames import FrameStore
from racines_models.judges.grader.model import Grader
from racines_models.statistics import bootstrap_mean

BATCH = 64
"""Images of a timed call."""
ROUNDS = 15
"""Timed calls of each; the best counts, since what else the machine does only slows."""


def agreement(
    student: Grader, teacher: Grader, store: FrameStore, split: str = "test"
) -> dict[str, Any]:
    """Compare the answers on a split.

    Returns:
        `view`: share of frames with the teacher's label; `grade_mae`: mean absolute difference of
        the grades on frames that the teacher calls a view; each with value, low, high, n.
    """
    rows = store.split_indices(split)
    images, trajectory = store.take(rows).images, store.trajectory_index[rows].numpy()
    (ours, our_grades, _), (theirs, grades, _) = student.judge(images), teacher.judge(images)
    shown = theirs != len(teacher.labels) - 1
    error = (our_grades - grades).abs().double()
    error = torch.where(shown, error, torch.nan).numpy()
    rule = "the student's label is the teacher's"
    same = bootstrap_mean((ours == theirs).double().numpy(), trajectory).to_json(rule=rule)
    compared: dict[str, Any] = {"split": split, "view": same}
    if bool(shown.any()):
        rule = "mean absolute difference, frames that the teacher calls a view"
        compared["grade_mae"] = bootstrap_mean(error, trajectory).to_json("grades of 10", rule=rule)
    return compared


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
            seconds = _seconds(grader, images)
            if turn >= 2:  # the first calls set up kernels and memory
                best[name] = min(best.get(name, seconds), seconds)
    rates = {name: round(BATCH / seconds, 1) for name, seconds in best.items()}
    how: dict[str, Any] = {"batch_size": BATCH, "threads": torch.get_num_threads()}
    how["device"] = str(teacher.device)
    return rates | {"ratio": round(best["teacher"] / best["student"], 2), "rounds": ROUNDS} | how


def _seconds(grader: Grader, images: torch.Tensor) -> float:
    began = time.perf_counter()
    _, grades = grader.probabilities_and_grade(images)
    grades.cpu()  # waits for the device
    return time.perf_counter() - began
