from .source import ReleaseSource as ReleaseSource
from .source import ReleaseUnit as ReleaseUnit
from .survey import ReleaseConfig as ReleaseConfig

__all__ = ["ReleaseConfig", "ReleaseSource", "ReleaseUnit"]
