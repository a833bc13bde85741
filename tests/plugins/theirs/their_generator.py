"""A generator, by the protocol alone: one ramp of gray for all poses."""

from dataclasses import asdict, dataclass
from pathlib import Path

import torch

from racines_models.protocol import Card


@dataclass
class Config:
    level: int = 60


class Flat:
    name = "flat"
    Config = Config

    def __init__(self, config=None):
        self.config = config or Config()

    @property
    def card(self):
        return Card(
            "flat", "Flat", "One ramp of gray.", "a test", False, 1, {}, asdict(self.config), 0,
            conditional=False,
        )  # fmt: skip

    def fit(self, store, run):
        self.config.level = int(next(store.batches("train", 64, seed=0)).images.float().mean())
        self.save(run.folder)
        return {}

    def generate(self, parameters, seed):
        ramp = (torch.arange(128) // 4 + self.config.level).to(torch.uint8)
        return ramp.expand(len(parameters), 128, 128).clone()

    def save(self, folder):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "level.txt").write_text(str(self.config.level))

    @classmethod
    def load(cls, folder, device="cpu"):
        return cls(Config(int((Path(folder) / "level.txt").read_text())))
