"""What a scout tells of the volume between its frames: gathered in voxels, filled in by a prior.

    frames of the scout ──> voxels that they pass, in the frame of the mean probe
    ──> 3-D U-Net: what lies between ──> numbers at the places of the asked slice's cells

Every patient's scout passes the same views, so that hearts lie much alike in the frame of its mean
probe, wherever the patient lies; what hearts have in common is learned there.
"""

import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d, grid_sample, normalize

from racines_data.geometry import Pose, orthonormalise
from racines_models.networks.scouting import GRID, Scouts, places, relative, sampled

VOXEL, VOXELS = 0.005, 40
"""Edge of a voxel, m, and voxels along an edge of the cube, which begins at the probe's face."""
PASSED = 0.003
"""Distance of a voxel from a frame's plane, m, at which the frame counts by exp(-1/2)."""
SHOWN = 9
"""Numbers that a voxel has from the frames."""
LEAST = 1e-3
"""Weight by which a voxel that hardly any frame passes counts as black."""
ABOUT = 9
"""Numbers that say how an asked slice lies in the cube."""


def frame_of(poses: Pose) -> Pose:
    """Return the (G,) frames of the mean probe of (G, S) poses."""
    mean = poses.rotation.double().mean(1)
    return Pose(poses.position.mean(1), orthonormalise(mean).to(poses.rotation.dtype))


def gathered(scouts: Scouts) -> Tensor:
    """Return (G, 9, 40, 40, 40) of what the frames of G scouts show in the voxels that they pass.

    Of each voxel: how much passes it, gray level and its deviation, gray level seen from each
    direction, and the mean direction. Axes are depth, elevation and lateral, as images have them.
    """
    return torch.cat([_gathered(scouts.of(torch.tensor([row]))) for row in range(len(scouts.lit))])


def _gathered(scouts: Scouts) -> Tensor:
    device, home = scouts.lit.device, frame_of(scouts.poses)
    middle = (torch.arange(VOXELS, device=device) + 0.5) * VOXEL
    side = middle - VOXELS * VOXEL / 2
    depth, off, across = torch.meshgrid(middle, side, side, indexing="ij")
    voxels = torch.stack([across, off, depth]).flatten(1)
    lit, total = avg_pool2d(scouts.lit, 2), voxels.new_zeros(SHOWN, voxels.shape[1])
    turns, shifts = (part[0] for part in relative(home, scouts.poses))
    for image, turn, shift in zip(scouts.images[0], turns, shifts, strict=True):
        # No voxel twice in a frame: the sums have one order on every device.
        apart = turn[1] @ voxels + shift[1]
        near = (apart.abs() < 3.0 * PASSED).nonzero().squeeze(1)
        at = turn @ voxels[:, near] + shift.unsqueeze(1)
        maps = torch.stack([image.unsqueeze(0), lit], 1)
        seen = sampled(maps, at[None, None, ..., None], scouts.pixel.view(1, 1, 1, 1))
        gray, inside = seen[0, ..., 0]
        weight = (-0.5 * (at[1] / PASSED).square()).exp() * inside
        way = turn.T @ normalize(at, dim=0)  # from the probe, in the axes of the cube
        told = torch.cat(
            [torch.stack([torch.ones_like(gray), gray, gray.square()]), gray * way, way]
        )
        total[:, near] += weight * told
    weight = total[:1]
    means = total[1:] / (weight + LEAST)
    deviation = (means[1:2] - means[:1].square()).clamp_min(0.0).sqrt()
    shown = torch.cat([weight.log1p(), means[:1], deviation, means[2:]])
    return shown.view(1, SHOWN, VOXELS, VOXELS, VOXELS)


class Prior(nn.Module):
    """Fills in voxels that no frame passes, by a 3-D U-Net (of MONAI)."""

    def __init__(self, width: int, channels: int) -> None:
        """Build with `width` channels at 20³ voxels, and `channels` that are looked up."""
        super().__init__()
        from monai.networks.nets.unet import UNet

        norm = ("group", {"num_groups": 8})
        self.net = UNet(
            3, SHOWN, channels, (width, 2 * width, 4 * width), (2, 2), num_res_units=1,
            act="relu", norm=norm,
        )  # fmt: skip

    def forward(self, shown: Tensor) -> Tensor:
        """Return (G, channels, 40, 40, 40) of (G, 9, 40, 40, 40)."""
        return self.net(shown)


def looked_up(
    volume: Tensor, home: Pose, pose: Pose, cells: Tensor, pixel: Tensor
) -> tuple[Tensor, Tensor]:
    """Return what (G, C, 40, 40, 40) volumes hold at the cells of asked slices.

    Args:
        volume: of G patients, in their frames `home`.
        home: (G,).
        pose: (B,) the slices, equally many of each patient, patient after patient.
        cells: (2, 32, 32) the cells' middles, in pixels from the apex.
        pixel: (B,) m, a pixel's side.

    Returns:
        (B, C, 32, 32), 0 outside the cube, and (B, 9) how the slice lies in it.
    """
    each = len(pose.position) // len(volume)
    frames = Pose(*(part.repeat_interleave(each, 0).unsqueeze(1) for part in home))
    turn, shift = relative(pose, frames)
    at = places(turn, shift, cells * pixel.view(-1, 1, 1, 1))[:, 0]
    half = VOXELS * VOXEL / 2
    grid = torch.stack([at[:, 0] / half, at[:, 1] / half, at[:, 2] / half - 1.0], -1)
    found = grid_sample(volume, grid.view(len(volume), each, GRID, GRID, 3), align_corners=False)
    about = torch.cat([shift[:, 0] / 0.05, turn[:, 0, :, 0], turn[:, 0, :, 2]], 1)
    return found.transpose(1, 2).flatten(0, 1), about
