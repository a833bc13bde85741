"""Where in space a pixel lies: the probe's geometry and its calibration, which is learned."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import grid_sample

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, axis_angle_to_matrix, matmul3, rotate
from racines_data.imaging import IMAGE_SIZE


@dataclass(frozen=True)
class ProbeGeometry:
    """What is known of the probe before training; lengths are only where learning starts from."""

    kind: str = "sector"
    """`sector`: beams from an apex. `plane`: beams run straight down the columns of the image."""
    beams: int = 96
    samples: int = 144
    """Size of the grid along the beams on which the image is made."""
    half_angle: float = 0.68
    """Half of the sector's angle, rad: the sector is as wide as the image."""
    depth: float = 0.155
    """Length of the beams, m; of a `plane`, the height of the image."""
    face: float = 0.0
    """Radius of a convex face, m; 0 for a phased array, whose beams start at one point."""
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The face's centre in the frame of the recorded pose, m."""
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Rotation of the image in that frame (rotation vector), rad."""
    side: float = 0.0
    """Side of the image, m, where it cuts off a wider sector; 0: as wide as the sector."""

    def __post_init__(self) -> None:
        if self.kind not in ("sector", "plane"):
            raise RacinesError(f"scene-field.probe.kind: {self.kind!r}: use sector or plane")
        if min(self.beams, self.samples) < 8 or self.beams % 2 or self.samples % 2:
            raise RacinesError("scene-field.probe: beams and samples are even and at least 8")
        if not 0.0 < self.half_angle < math.pi / 2 or self.depth <= 0 or self.face < 0:
            raise RacinesError("scene-field.probe: half_angle, depth and face describe no sector")
        if self.side < 0:
            raise RacinesError("scene-field.probe.side: 0 or more, m")


class Probe(nn.Module):
    """Lays the grid of beams into space, and the image out of it.

    Learned: shift (mm) and turn (rad) of the image in the frame of the pose, the logarithm of its
    scale, and the offset of each sample out of the image plane, mm. Positions of poses come in
    units of so many `metres`.
    """

    lateral: Tensor
    axial: Tensor
    across: Tensor
    along: Tensor
    pixels: Tensor
    mask: Tensor

    def __init__(self, geometry: ProbeGeometry, metres: float = 1.0):
        super().__init__()
        self._millimetres = 1e3 * metres
        self.shift = nn.Parameter(torch.tensor(geometry.shift) * 1e3)
        self.turn = nn.Parameter(torch.tensor(geometry.turn))
        self.scale = nn.Parameter(torch.zeros(()))
        self.offset = nn.Parameter(torch.zeros(geometry.beams, geometry.samples))
        lay = _sector if geometry.kind == "sector" else _plane
        for name, grid in lay(geometry).items():
            self.register_buffer(name, grid, persistent=False)

    def calibration(self) -> dict[str, list[float] | float]:
        """Return shift, m, turn, rad, and scale as learned."""
        return {
            "shift_m": [round(x * 1e-3, 6) for x in self.shift.tolist()],
            "turn_rad": [round(x, 5) for x in self.turn.tolist()],
            "scale": round(self.scale.exp().item(), 5),
        }

    def points(self, pose: Pose, coarse: bool = False) -> Tensor:
        """Return (3, B, beams, samples) positions, mm; coarse ones lie between 2 x 2 samples."""
        grids = torch.stack([self.lateral, self.offset, self.axial])
        if coarse:
            grids = grids.unflatten(2, (-1, 2)).unflatten(1, (-1, 2)).mean((2, 4))
        scale = torch.stack([self.scale, torch.zeros_like(self.scale), self.scale]).exp()
        local = axis_angle_to_matrix(self.turn) @ (scale.unsqueeze(1) * grids.flatten(1))
        local = (local + self.shift.unsqueeze(1)).view_as(grids)
        placed = (pose.rotation.flatten(0, 1) @ local.flatten(1)).view(-1, *local.shape)
        return (placed + (pose.position * self._millimetres).view(-1, 3, 1, 1)).transpose(0, 1)

    def directions(self, pose: Pose) -> Tensor:
        """Return (B, beams, 3) unit vectors of the beams."""
        local = torch.stack([self.across, torch.zeros_like(self.across), self.along], -1)
        axes = matmul3(pose.rotation, axis_angle_to_matrix(self.turn))  # of the image, as columns
        return rotate(axes.unsqueeze(1), local)

    def image(self, polar: Tensor) -> Tensor:
        """Turn (B, beams, samples) into (B, 128, 128), zero outside the sector."""
        grid = self.pixels.expand(polar.shape[0], -1, -1, -1)
        drawn = grid_sample(
            polar.unsqueeze(1), grid, "bilinear", padding_mode="border", align_corners=True
        )
        return drawn.squeeze(1) * self.mask


def _pixels() -> tuple[Tensor, Tensor]:
    """Return how far pixels lie right of the image's middle and below its top, pixels."""
    rows, columns = torch.meshgrid([torch.arange(float(IMAGE_SIZE))] * 2, indexing="ij")
    return columns - (IMAGE_SIZE - 1) / 2, rows + 0.5


def _sector(geometry: ProbeGeometry) -> dict[str, Tensor]:
    half, face = geometry.half_angle, geometry.face * 1e3
    depth, samples = geometry.depth * 1e3, geometry.samples
    angle = torch.linspace(-half, half, geometry.beams)
    radius = face + (torch.arange(samples) + 0.5) * (depth / samples)
    lateral = angle.sin().unsqueeze(1) * radius
    axial = angle.cos().unsqueeze(1) * radius - face
    wide = 1e3 * geometry.side or 2.0 * (face + depth) * math.sin(half)
    pixel = wide / IMAGE_SIZE
    right, down = (x * pixel for x in _pixels())
    down = down + face
    reach = (right.square() + down.square()).sqrt()
    at = torch.atan2(right, down)
    place = ((reach - face) / depth * samples - 0.5) / (samples - 1) * 2.0 - 1.0
    mask = (at.abs() <= half) & (reach <= face + depth) & (reach >= face)
    return {
        "across": angle.sin(),
        "along": angle.cos(),
        "lateral": lateral,
        "axial": axial,
        "pixels": torch.stack([place, at / half], -1).unsqueeze(0),
        "mask": mask.to(torch.float32),
    }


def _plane(geometry: ProbeGeometry) -> dict[str, Tensor]:
    beams, samples, depth = geometry.beams, geometry.samples, geometry.depth * 1e3
    lateral = ((torch.arange(beams) + 0.5) / beams - 0.5) * depth
    axial = (torch.arange(samples) + 0.5) / samples * depth
    right, down = (x / IMAGE_SIZE for x in _pixels())
    place = (down * samples - 0.5) / (samples - 1) * 2.0 - 1.0
    at = ((right + 0.5) * beams - 0.5) / (beams - 1) * 2.0 - 1.0
    return {
        "across": torch.zeros(beams),
        "along": torch.ones(beams),
        "lateral": lateral.unsqueeze(1).expand(-1, samples),
        "axial": axial.expand(beams, -1),
        "pixels": torch.stack([place, at], -1).unsqueeze(0),
        "mask": torch.ones(IMAGE_SIZE, IMAGE_SIZE),
    }
