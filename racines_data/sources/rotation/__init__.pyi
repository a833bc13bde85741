from .source import RotationConfig as RotationConfig
from .source import RotationSource as RotationSource
from .source import TurnUnit as TurnUnit

__all__ = ["RotationConfig", "RotationSource", "TurnUnit"]
