from .episode_writer import CoreRecorder as CoreRecorder
from .episode_writer import EpisodeRecorder as EpisodeRecorder
from .episode_writer import record_rollout as record_rollout
from .rerun import RecordedEpisode as RecordedEpisode
from .rerun import Rerun as Rerun
from .rerun import read_recording as read_recording
from .rerun import rerun as rerun

__all__ = [
    "CoreRecorder",
    "EpisodeRecorder",
    "RecordedEpisode",
    "Rerun",
    "read_recording",
    "record_rollout",
    "rerun",
]
