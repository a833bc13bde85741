from .field import ROWS as ROWS
from .field import SIDE as SIDE
from .field import Layout as Layout
from .field import VoxelField as VoxelField
from .field import lay_out as lay_out

__all__ = ["Layout", "ROWS", "SIDE", "VoxelField", "lay_out"]
