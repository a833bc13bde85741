from .source import FARTHEST as FARTHEST
from .source import NEAREST as NEAREST
from .source import READER as READER
from .source import UNITS as UNITS
from .source import TrackedConfig as TrackedConfig
from .source import TrackedSource as TrackedSource
from .source import TrackedUnit as TrackedUnit

__all__ = [
    "FARTHEST",
    "NEAREST",
    "READER",
    "TrackedConfig",
    "TrackedSource",
    "TrackedUnit",
    "UNITS",
]
