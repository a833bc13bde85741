# pyright: strict
"""The box that a heart is baked into, and how its neighbours and its surroundings are addressed.

All hearts share one box of 128³ voxels in the organ's frame. Around it lies, without end, one
periodic tile of 64 x 64 x 32 voxels, and where the box has no heart it is that tile to the last
byte: so there is no edge to be seen, wherever a probe looks. Liver and chest wall are tiles too.

    one heart: | box 128³ | surroundings | liver | chest wall |   19.9 MB

A voxel is eight bytes, as the phantom's but for the last. Bytes 0-3: complex scatterer amplitude,
two int16 in `SCATTERER_STEP`. Bytes 4-6: impedance gradient from voxel to voxel along the box's
axes, three int8 in `REFLECTOR_STEP`. Byte 7: label in the low six bits, attenuation class in the
high two.
"""

import torch
from torch import Tensor

BOX_BITS = 7
BOX = 1 << BOX_BITS
VOXEL = (1.20, 1.12, 1.42)
"""Edges of a voxel, mm: the box is 154 x 143 x 182 mm, as the organ is longer than wide."""
LOW = (-98.2, -63.6, -69.8)
"""Corner of the box, mm, organ frame."""
TILE = (64, 64, 32)
"""Voxels of each tile, all laid out alike; the box holds a whole number of them."""
CHEST_LEVELS = TILE[2]
"""Voxels through the chest wall, whatever its thickness."""
BOX_SIZE, TILE_SIZE = BOX**3, TILE[0] * TILE[1] * TILE[2]
TILE_AT, LIVER_AT, CHEST_AT = BOX_SIZE, BOX_SIZE + TILE_SIZE, BOX_SIZE + 2 * TILE_SIZE
HEART_SIZE = BOX_SIZE + 3 * TILE_SIZE
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
