"""The label volume that other simulators slice: the tissues of our block, at its own resolution."""

import torch
from torch import Tensor

from racines_data.geometry import Pose
from racines_data.phantom.acoustics import pixel_grid
from racines_data.phantom.anatomy import Anatomy, load_anatomy
from racines_data.phantom.config import PhantomConfig

AIR = 0
"""Label outside of the block; tissues count from 1."""


class LabelVolume:
    """Tissues of the block on a grid, and the planes that a probe sees of it."""

    def __init__(self, config: PhantomConfig | None = None) -> None:
        """Paint the block of a configuration, the default's."""
        self.config = config = config or PhantomConfig()
        self.anatomy: Anatomy = load_anatomy(config.anatomy, config.anatomy_seed)
        block, probe = config.block, config.probe
        low, high = torch.tensor(block.minimum), torch.tensor(block.maximum)
        shape = ((high - low) / block.voxel).round().to(torch.int64)
        axes = [low[i] + (torch.arange(int(shape[i])) + 0.5) * block.voxel for i in range(3)]
        self.labels = torch.zeros([int(n) + 2 for n in shape], dtype=torch.int64)
        for i, x in enumerate(axes[0].tolist()):  # a sheet at a time bounds the memory
            points = torch.cartesian_prod(torch.tensor([x]), axes[1], axes[2])
            painted = self.paint(points).view(len(axes[1]), len(axes[2]))
            self.labels[i + 1, 1:-1, 1:-1] = painted + 1
        self.origin, self.voxel = low - 0.5 * block.voxel, block.voxel
        self.flat, self.shape = self.labels.flatten(), self.labels.shape
        lateral, axial = (each.float() for each in pixel_grid(probe))
        self.pixels = torch.stack([lateral, axial], -1)
        angle = torch.linspace(-probe.half_angle, probe.half_angle, probe.beams).unsqueeze(1)
        depth = (torch.arange(probe.samples) + 0.5) * (probe.depth / probe.samples)
        self.rays = torch.stack([angle.sin() * depth, angle.cos() * depth], -1)

    def paint(self, points: Tensor) -> Tensor:
        """Return the tissues (M,) of (M, 3) points of the base frame, m."""
        axes, origin = torch.tensor(self.anatomy.axes), torch.tensor(self.anatomy.origin)
        return self.anatomy.paint((points - origin) @ axes.T)

    def points(self, pose: Pose, grid: Tensor) -> Tensor:
        """Return (B, H, W, 3) points of the base frame under an (H, W, 2) grid of the plane, m."""
        x, z = pose.rotation[:, None, None, :, 0], pose.rotation[:, None, None, :, 2]
        return pose.position[:, None, None] + grid[..., :1] * x + grid[..., 1:] * z

    def index(self, pose: Pose, grid: Tensor) -> Tensor:
        """Return (B, H, W) int64 voxels under a grid: `pixels`, or `rays`, one a row."""
        x, z = pose.rotation[:, :, 0], pose.rotation[:, :, 2]
        start = (pose.position - self.origin) / self.voxel + 0.5
        index = torch.zeros((), dtype=torch.int64)
        for axis, size in enumerate(self.shape):
            where = (grid[..., 0] / self.voxel) * x[:, axis, None, None]
            where = where.addcmul_(grid[..., 1] / self.voxel, z[:, axis, None, None])
            where += start[:, axis, None, None]
            index = index * size + where.clamp_(0, size - 1).to(torch.int64)
        return index
