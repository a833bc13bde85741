from .recorder import CoreRecorder as CoreRecorder
from .recorder import EpisodeRecorder as EpisodeRecorder
from .recorder import record_rollout as record_rollout
from .replay import Recording as Recording
from .replay import Replay as Replay
from .replay import read_recording as read_recording

__all__ = [
    "CoreRecorder",
    "EpisodeRecorder",
    "Recording",
    "Replay",
    "read_recording",
    "record_rollout",
]
