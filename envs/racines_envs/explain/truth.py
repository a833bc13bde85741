"""What truly lies in an image: the phantom's tissues and landmarks on the image plane."""

import torch
from torch import Tensor
from torch.nn import functional

from racines_data.geometry import Pose, rotate
from racines_data.imaging import IMAGE_SIZE
from racines_data.phantom.anatomy import load_anatomy
from racines_data.phantom.config import ProbeConfig
from racines_data.phantom.scan import pixel_grid, sector_mask
from racines_data.world import World

WALL = 2
"""Pixels on each side of a change of tissue that count as its border."""


def sector_of(world: World) -> Tensor:
    """Return the (128, 128) bool mask of the sector; everything where the probe is unknown."""
    if world.config is None:
        return torch.ones(IMAGE_SIZE, IMAGE_SIZE, dtype=torch.bool)
    return sector_mask(world.config.probe)


def plane_points(probe: ProbeConfig, pose: Pose) -> Tensor:
    """Return the (N, 128, 128, 3) points of the block under the pixels, base frame, m."""
    lateral, axial = (x.float() for x in pixel_grid(probe))
    local = torch.stack([lateral, torch.zeros_like(lateral), axial], -1)
    turned = rotate(pose.rotation.cpu()[:, None, None], local)
    return turned + pose.position.cpu()[:, None, None]


def true_regions(world: World, pose: Pose, view: str) -> dict[str, Tensor]:
    """Return named (N, 128, 128) bool regions of the images at (N,) poses.

    `organ`: not the gel around it. `borders`: within two pixels of a change of tissue. `landmarks`:
    inside the spheres of the structures that the view has to show. Empty for a stand-in phantom
    without an anatomy.
    """
    config = world.config
    if config is None:
        return {}
    anatomy = load_anatomy(config.anatomy, config.anatomy_seed)
    axes, origin = torch.tensor(anatomy.axes), torch.tensor(anatomy.origin)
    points = (plane_points(config.probe, pose) - origin) @ axes.T
    tissue = torch.stack([anatomy.paint(p.reshape(-1, 3)) for p in points])
    tissue = tissue.view(points.shape[:-1])
    wanted = {name for name, _ in next(v for v in anatomy.views if v.name == view).structures}
    landmarks = torch.zeros_like(tissue, dtype=torch.bool)
    for structure in anatomy.structures:
        if structure.name in wanted:
            away = (points - torch.tensor(structure.centre)).norm(dim=-1)
            landmarks |= away < structure.radius
    level, size = tissue.float().unsqueeze(1), 2 * WALL + 1
    highest = functional.max_pool2d(level, size, 1, WALL)
    lowest = -functional.max_pool2d(-level, size, 1, WALL)
    borders = (highest != lowest).squeeze(1)
    return {"organ": tissue != 0, "borders": borders, "landmarks": landmarks}
