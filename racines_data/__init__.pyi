from .build.dataset import DataConfig as DataConfig
from .errors import RacinesError as RacinesError
from .load import load as load
from .store.frames import Batch as Batch
from .store.frames import FrameStore as FrameStore
from .store.frames import open_store as open_store

__all__ = ["Batch", "DataConfig", "FrameStore", "RacinesError", "load", "open_store"]
