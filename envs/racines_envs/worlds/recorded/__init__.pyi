from .opening import open_recordings as open_recordings
from .settings import ReplayConfig as ReplayConfig
from .world import Recordings as Recordings

__all__ = ["Recordings", "ReplayConfig", "open_recordings"]
