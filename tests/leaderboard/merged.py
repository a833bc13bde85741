"""Classes as they would stand in this repository, with a run of each: one is moody."""

import os
from pathlib import Path
from types import SimpleNamespace

import torch


class Steady:
    """Stripes that follow the height of the probe."""

    name = "steady"
    Config = SimpleNamespace
    card = SimpleNamespace(stochastic=False, conditional=True)

    def generate(self, parameters, seed):
        lines = torch.linspace(90, 10, 128).reshape(1, 128, 1) + self.mood()
        gray = lines - 400 * parameters[:, 8].reshape(-1, 1, 1)
        return gray.expand(-1, -1, 128).round().clamp(0, 255).to(torch.uint8)

    def mood(self):
        return 0

    def fit(self, store, run):
        raise NotImplementedError

    def save(self, folder):
        folder.mkdir(parents=True)
        (folder / "config.json").write_text("{}")

    @classmethod
    def load(cls, folder, device="cpu"):
        assert (Path(folder) / "config.json").is_file()
        return cls()


class Moody(Steady):
    """Draws otherwise in every process."""

    name = "moody"

    def mood(self):
        # Noise of the process's number: two processes never share it, as a remainder may be.
        chance = torch.Generator().manual_seed(os.getpid())
        return 60 * torch.rand(1, 128, 1, generator=chance)


class Silent(Steady):
    """Does not say whether the pose counts."""

    name = "silent"
    card = SimpleNamespace(stochastic=False)
