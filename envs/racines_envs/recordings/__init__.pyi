from .episodes import CoreRecorder as CoreRecorder
from .episodes import EpisodeRecorder as EpisodeRecorder
from .episodes import RecordedEpisode as RecordedEpisode
from .episodes import Rerun as Rerun
from .episodes import read_recording as read_recording
from .episodes import record_rollout as record_rollout
from .episodes import rerun as rerun

__all__ = [
    "CoreRecorder",
    "EpisodeRecorder",
    "RecordedEpisode",
    "Rerun",
    "read_recording",
    "record_rollout",
    "rerun",
]
