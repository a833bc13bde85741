from .writer import CHUNK_FILES as CHUNK_FILES
from .writer import FILE_MEGABYTES as FILE_MEGABYTES
from .writer import IMAGE as IMAGE
from .writer import Shown as Shown
from .writer import export as export
from .writer import hf_features as hf_features
from .writer import task_of as task_of

__all__ = ["CHUNK_FILES", "FILE_MEGABYTES", "IMAGE", "Shown", "export", "hf_features", "task_of"]
