"""What a learned generator sees of the twelve parameters."""

import torch
from torch import Tensor, nn

from racines_data.errors import RacinesError
from racines_data.geometry import parameters_to_pose, rotation_6d

MODES = {"continuous": 15, "euler": 12}
"""Width of the condition vector in each mode."""


class Conditioning(nn.Module):
    """Normalises (B, 12) parameters to a condition vector.

    `continuous`: position (3), 6-D rotation (6), force and torque (6). `euler`: the twelve columns
    as they are, which jump where rotation_x passes ±π (the paper's conditioning, kept as an
    ablation). Each entry is standardised with the mean and deviation of the training frames; an
    absent force (NaN) becomes 0, the training mean.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, mode: str = "continuous"):
        super().__init__()
        if mode not in MODES:
            raise RacinesError(f"conditioning {mode!r} is unknown: choose {' or '.join(MODES)}")
        self.mode = mode
        self.width = MODES[mode]
        self.register_buffer("mean", torch.zeros(self.width))
        self.register_buffer("std", torch.ones(self.width))

    def encode(self, parameters: Tensor) -> Tensor:
        """Return the (B, width) condition before standardisation, NaN where a force is absent."""
        if self.mode == "euler":
            return parameters
        pose = parameters_to_pose(parameters)
        return torch.cat([pose.position, rotation_6d(pose.rotation), parameters[..., :6]], -1)

    def fit(self, parameters: Tensor) -> "Conditioning":
        """Take mean and deviation from (N, 12) training parameters; without spread, 1."""
        raw = self.encode(parameters.double())
        known = torch.isfinite(raw)
        count = known.sum(0).clamp_min(1)
        mean = raw.where(known, 0.0).sum(0) / count
        std = ((raw - mean).where(known, 0.0).square().sum(0) / count).sqrt()
        self.mean.copy_(mean)
        self.std.copy_(std.where(std > 1e-6, 1.0))
        return self

    def forward(self, parameters: Tensor) -> Tensor:
        """Return the (B, width) float32 standardised condition of (B, 12) parameters."""
        return torch.nan_to_num((self.encode(parameters) - self.mean) / self.std, nan=0.0)
