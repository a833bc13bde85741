"""What the teacher says of the train frames and of their variants, asked once and kept on disk.

A variant is a function of (seed, frame, variant), so that the student, who looks at it epochs
later, sees what the teacher saw. Variant 0 is the frame itself.
"""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from racines_data.randomness import derive
from racines_data.store.frames import FrameStore
from racines_models.judges.grader.model import Grader
from racines_models.training.augmentation import Augmentation, augment
from racines_models.weights import save_weights

VARIANT = 31
"""Random stream of the variants."""
CHUNK = 4096
"""Frames of one file: what a killed run has to ask again."""
BATCH = 256


def variants(
    x: Tensor, rows: Tensor, which: Tensor, seed: int, augmentation: Augmentation
) -> Tensor:
    """Return the variants that `which` (B,) names of (B, 1, S, S) images as the teacher takes them.

    `rows` (B,) are those of the frames in the store; variant 0 leaves the image as it is.
    """
    seeds = derive(derive(torch.tensor(seed), VARIANT, rows), which).to(x.device)
    varied = augment(x, seeds, augmentation)
    return torch.where(which.to(x.device).view(-1, 1, 1, 1) == 0, x, varied)


class SoftLabels(NamedTuple):
    """The teacher's (V, N, L) float32 `logits` and (V, N) `grades` of N frames in V variants."""

    logits: Tensor
    grades: Tensor


def ask_teacher(
    teacher: Grader,
    store: FrameStore,
    augmentation: Augmentation,
    count: int,
    seed: int,
    folder: Path,
    progress: Callable[[int], None],
) -> SoftLabels:
    """Ask of the whole train split; what `folder` has already is not asked again.

    `folder` must belong to this teacher, dataset, augmentation and seed.
    """
    rows = store.split_indices("train")
    parts = []
    for variant in range(count):
        for number, chunk in enumerate(rows.split(CHUNK)):
            path = folder / f"{variant:02d}-{number:04d}.safetensors"
            try:
                answers = load_file(path)
            except (SafetensorError, OSError):  # not asked yet, or damaged
                answers = _ask(teacher, store, augmentation, chunk, variant, seed)
                save_weights(path, answers)
            parts.append(answers)
            progress(len(chunk))
    logits, grades = (torch.cat([part[key] for part in parts]) for key in ("logits", "grades"))
    shape = (count, len(rows))
    return SoftLabels(logits.view(*shape, -1), grades.view(shape))


@torch.inference_mode()
def _ask(
    teacher: Grader,
    store: FrameStore,
    augmentation: Augmentation,
    rows: Tensor,
    variant: int,
    seed: int,
) -> dict[str, Tensor]:
    parts = []
    for batch in rows.split(BATCH):
        x = teacher.network.normalise(store.take(batch).images.to(teacher.device))
        x = variants(x, batch, torch.full_like(batch, variant), seed, augmentation)
        parts.append(teacher.answer(x))
    logits, grades = (torch.cat([part[i] for part in parts]).cpu() for i in (0, 1))
    return {"logits": logits, "grades": grades}
