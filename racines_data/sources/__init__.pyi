from .base import SOURCES as SOURCES
from .base import Finding as Finding
from .base import Source as Source
from .base import SourceCard as SourceCard
from .base import Unit as Unit
from .base import has_poses as has_poses
from .base import labels_of_source as labels_of_source
from .base import source_class as source_class
from .base import source_names as source_names

__all__ = [
    "SOURCES",
    "Finding",
    "Source",
    "SourceCard",
    "Unit",
    "has_poses",
    "labels_of_source",
    "source_class",
    "source_names",
]
