from .source import CactusConfig as CactusConfig
from .source import CactusSource as CactusSource
from .source import CactusUnit as CactusUnit
from .source import Size as Size

__all__ = ["CactusConfig", "CactusSource", "CactusUnit", "Size"]
