from .frames import Batch as Batch
from .frames import FrameStore as FrameStore
from .frames import open_store as open_store

__all__ = ["Batch", "FrameStore", "open_store"]
