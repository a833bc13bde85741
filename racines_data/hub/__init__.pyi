from .fetch import KIND as KIND
from .fetch import STORE_FOLDER as STORE_FOLDER
from .fetch import download as download
from .fetch import hub_errors as hub_errors
from .fetch import hub_files as hub_files

__all__ = ["KIND", "STORE_FOLDER", "download", "hub_errors", "hub_files"]
