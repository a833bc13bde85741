"""A small dataset of smooth pictures that follow the pose: a sector with moving blobs."""

from pathlib import Path

import pytest
import torch
from torch import Tensor

from racines_data.geometry import parameters_to_pose
from racines_data.store.frames import Batch, BatchMemory, FrameStore

TRAIN, VALIDATION, TEST = 240, 32, 16


def random_parameters(count: int, seed: int) -> Tensor:
    """Poses that look down, within a few centimetres and half a radian; small forces."""
    generator = torch.Generator().manual_seed(seed)
    spread = torch.tensor([2, 2, 2, 0.2, 0.2, 0.2, 0.03, 0.03, 0.01, 0.3, 0.2, 0.5])
    centre = torch.tensor([0, 0, -9, 0, 0, 0, 0.49, 0.0, 0.06, torch.pi, 0, 0])
    noise = torch.rand(count, 12, generator=generator) * 2 - 1
    parameters = centre + spread * noise
    # rotation_x wraps at ±π, as in the recorded data.
    parameters[:, 9] = torch.atan2(parameters[:, 9].sin(), parameters[:, 9].cos())
    return parameters.float()


def pictures(parameters: Tensor) -> Tensor:
    """(B, 128, 128) uint8: two blobs in a sector, placed by position and rotation."""
    pose = parameters_to_pose(parameters)
    x, y = torch.meshgrid(torch.linspace(-1, 1, 128), torch.linspace(0, 1, 128), indexing="xy")
    sector = (torch.atan2(x, y).abs() < 0.75) & (x.hypot(y) < 1)
    shift = (pose.position - torch.tensor([0.49, 0.0, 0.06])) / 0.03
    turn = pose.rotation[:, 0, 1]
    centres = [(shift[:, 0] * 0.3, 0.5 + 0.2 * shift[:, 1]), (-0.3 * turn, 0.75 + 0.2 * turn)]
    image = torch.full((len(parameters), 128, 128), 0.15)
    for u, v in centres:
        square = (x - u[:, None, None]) ** 2 + (y - v[:, None, None]) ** 2
        image = image + 0.7 * torch.exp(-square / 0.02)
    return (image * sector).clamp(0, 1).mul(255).round().to(torch.uint8)


class FakeStore(FrameStore):
    """What generators use of a store, in memory."""

    def __init__(self, seed: int = 0, train: int = TRAIN):
        count = train + VALIDATION + TEST
        self.parameters = random_parameters(count, seed)
        self.images = pictures(self.parameters)
        self.views = torch.zeros(count, dtype=torch.int64)
        self.grades = torch.full((count,), 5.0)
        self.manifest = {
            "source": "phantom",
            "version": "0.0.1",
            "digest": f"digest-{seed}-{train}",
            "recipe_digest": f"recipe-{seed}-{train}",
        }
        bounds = (0, train, train + VALIDATION, count)
        names = ("train", "validation", "test")
        self._memory = BatchMemory()
        self._splits = {name: list(bounds[i : i + 2]) for i, name in enumerate(names)}

    def take(self, index: Tensor, out: Tensor | None = None) -> Batch:
        images, parameters = self.images[index], self.conditions(index)
        return Batch(images, parameters, self.views[index], self.grades[index], index)


@pytest.fixture(scope="session")
def store() -> FakeStore:
    return FakeStore()


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    return tmp_path / "run"
