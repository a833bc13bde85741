"""An agent that never moves."""

from dataclasses import dataclass

import torch

from racines_envs.task.actions import IDLE


@dataclass
class Config:
    pass


class Still:
    name = "still"
    observation = "params"
    Config = Config

    def attach(self, core):
        self.rows = core.num_envs

    def act(self, observation, seeds):
        return torch.full((self.rows,), IDLE)

    def train(self, *given, **named):
        return {}

    @classmethod
    def load(cls, folder, device="cpu"):
        return cls()
