from .source import ReleaseConfig as ReleaseConfig
from .source import ReleaseSource as ReleaseSource
from .source import ReleaseUnit as ReleaseUnit

__all__ = ["ReleaseConfig", "ReleaseSource", "ReleaseUnit"]
