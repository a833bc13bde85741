from .mapping import Mapping as Mapping
from .mapping import read_mapping as read_mapping
from .source import TableSource as TableSource

__all__ = ["Mapping", "TableSource", "read_mapping"]
