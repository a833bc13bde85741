"""A store of made-up frames and kits of it: no dataset is built, no network is trained."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_data.store.frames import Batch
from racines_data.views import LABELS
from racines_leaderboard.expert.kit import Kit
from racines_leaderboard.expert.sample import Study, System, make_kit
from tests.leaderboard.conftest import DIGEST

RECIPE = DIGEST


class Frames:
    """What a study asks of a store: frames of known view and grade, in trajectories."""

    labels, phased = LABELS, False

    def __init__(self, count: int = 600, trajectories: int = 60, source: str = "phantom") -> None:
        rng = np.random.default_rng(5)
        self.views = torch.from_numpy(rng.integers(0, len(LABELS), count))
        grades = torch.from_numpy(rng.uniform(1.0, 10.0, count)).float()
        self.grades = torch.where(self.views == len(LABELS) - 1, 0.0, grades)
        self.trajectory_index = torch.arange(count) % trajectories
        self.frame = torch.arange(count)
        self.trajectories = [f"t{i}" for i in range(trajectories)]
        self.images = torch.from_numpy(rng.integers(0, 256, (count, 128, 128), np.uint8))
        self.parameters = torch.from_numpy(rng.normal(size=(count, 12))).float()
        self.manifest = {
            "source": source,
            "version": "1.0.0",
            "digest": "cd" * 32,
            "recipe_digest": RECIPE,
        }

    def split_indices(self, split: str) -> Tensor:
        return torch.arange(len(self.views))

    def take(self, rows: Tensor) -> Batch:
        columns = (self.images, self.parameters, self.views, self.grades)
        return Batch(*(column[rows] for column in columns), rows)


class Inverse:
    """A generator that draws noise of its own for each pose."""

    name = "inverse"

    def generate(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        seeds = torch.as_tensor(seed).expand(len(parameters)).tolist()
        draws = [np.random.default_rng(abs(s)).integers(0, 256, (128, 128)) for s in seeds]
        return torch.from_numpy(np.stack(draws).astype(np.uint8))


class Judge:
    """A grader that sees no view in a dark corner, and an SC of grade 5 in a bright one."""

    settings: dict[str, Any] = {"id": "corner"}
    labels = LABELS

    def check_labels(self, labels: Any, what: str) -> None:
        assert tuple(labels) == LABELS

    def judge(self, images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        dark = images[:, 0, 0] < 128
        label = torch.where(dark, len(LABELS) - 1, 1)
        return label, torch.where(dark, 0.0, 5.0), torch.zeros(len(images), 1)


def frames(**changes: Any) -> Any:
    return Frames(**changes)


def kit_of(folder: Path, store: Any = None, grader: Any = None, **study: Any) -> Kit:
    """Make a kit of one generator and the true frames."""
    systems = [System("inverse", Inverse(), {"w": "12"}), System("true-frames", None)]
    chosen = Study(**({"images": 60, "repeats": 12} | study))
    return make_kit(folder / "kit", store or frames(), systems, chosen, grader)
