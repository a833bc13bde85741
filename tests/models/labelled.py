"""A store with views, grades and trajectories: what graders and scores use, in memory."""

import torch
from torch import Tensor

from racines_data.store.frames import Batch, BatchMemory, FrameStore
from racines_data.views import RANDOM_LABEL
from tests.models.conftest import random_parameters

SHARES = {"train": 0.6, "validation": 0.1, "test": 0.3}


class LabelledStore(FrameStore):
    """Bars whose place is the view and whose length is the grade, over noise; L frames a sweep."""

    def __init__(self, trajectories: int = 20, length: int = 12, seed: int = 0):
        count = trajectories * length
        generator = torch.Generator().manual_seed(seed)
        self.config = "frames"
        self.parameters = random_parameters(count, seed)
        self.views = torch.arange(count) % 6
        grades = 1 + 9 * torch.rand(count, generator=generator)
        self.grades = torch.where(self.views == RANDOM_LABEL, 0.0, grades)
        self.images = bars(self.views, self.grades, generator)
        self.trajectory_index = torch.arange(trajectories).repeat_interleave(length)
        self.trajectories = [f"sweep-{i}" for i in range(trajectories)]
        self.manifest = {"source": "phantom", "version": "0.0.1"}
        self.manifest |= {"digest": f"labelled-{seed}-{count}", "recipe_digest": "recipe-0"}
        self._memory = BatchMemory()
        self._splits, start = {}, 0
        for split, share in SHARES.items():
            stop = min(start + round(share * trajectories) * length, count)
            self._splits[split] = [start, stop]
            start = stop

    def take(self, index: Tensor, out: Tensor | None = None) -> Batch:
        images, parameters = self.images[index], self.parameters[index]
        return Batch(images, parameters, self.views[index], self.grades[index], index)


def bars(views: Tensor, grades: Tensor, generator: torch.Generator) -> Tensor:
    """(B, 128, 128) uint8: a bar in the view's band, as long as the grade; Random has none."""
    images = torch.randint(20, 60, (len(views), 128, 128), generator=generator)
    for image, view, grade in zip(images, views.tolist(), grades.tolist(), strict=True):
        if view != RANDOM_LABEL:
            image[8 + 24 * view : 24 + 24 * view, 8 : 8 + int(11 * grade)] += 150
    return images.to(torch.uint8)


class Replay:
    """Draws what the store holds at a pose, made darker by a share."""

    def __init__(self, store: FrameStore, darker: float = 0.0):
        self.store, self.darker = store, darker

    def generate(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        row = torch.cdist(parameters, self.store.parameters).argmin(1)
        return (self.store.images[row] * (1 - self.darker)).to(torch.uint8)
