# pyright: strict
"""The box that a heart is baked into, and how its neighbours and its surroundings are addressed.

All hearts share one box of 128³ voxels in the organ's frame. Around it lies, without end, one
periodic tile of 64³ voxels, and where the box has no heart it is that tile to the last byte: so
there is no edge to be seen, wherever a probe looks. Liver and chest wall are tiles of their own.

    one heart: | box 128³ | surroundings 64³ | liver 32·64·32 | chest wall 64·32·32 |   19.9 MB

A voxel is eight bytes, as the phantom's but for the last. Bytes 0-3: complex scatterer amplitude,
two int16 in `SCATTERER_STEP`. Bytes 4-6: impedance gradient from voxel to voxel along the box's
axes, three int8 in `REFLECTOR_STEP`. Byte 7: label in the low six bits, attenuation class in the
high two.
"""

import torch
from torch import Tensor

BOX_BITS, TILE_BITS = 7, 6
BOX, TILE = 1 << BOX_BITS, 1 << TILE_BITS
VOXEL = (1.10, 1.06, 1.36)
"""Edges of a voxel, mm: the box is 141 x 136 x 174 mm, as the organ is longer than wide."""
LOW = (-90.0, -66.0, -70.0)
"""Corner of the box, mm, organ frame."""
LIVER_SHAPE = (32, 64, 32)
CHEST_SHAPE = (64, 32, 32)
"""Voxels of the tiles; the chest's third axis runs through the whole wall, once."""
BOX_SIZE, TILE_SIZE = BOX**3, TILE**3
LIVER_AT = BOX_SIZE + TILE_SIZE
CHEST_AT = LIVER_AT + 32 * 64 * 32
HEART_SIZE = CHEST_AT + 64 * 32 * 32
"""Voxels of one heart with its tiles."""
HEART_BYTES = 8 * HEART_SIZE


def centres(index: Tensor) -> Tensor:
    """Return the (M, 3) float64 centres of (M, 3) voxels by index, mm, organ frame."""
    scale = torch.tensor(VOXEL, dtype=torch.float64, device=index.device)
    low = torch.tensor(LOW, dtype=torch.float64, device=index.device)
    return (index.to(torch.float64) + 0.5) * scale + low


def to_voxels(points: Tensor) -> Tensor:
    """Return (…, 3) float64 points of the organ frame, mm, in voxels of the box."""
    return (points - points.new_tensor(LOW)) / points.new_tensor(VOXEL)
