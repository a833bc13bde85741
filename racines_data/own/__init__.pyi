from .make import from_labels as from_labels
from .make import from_mesh as from_mesh
from .pool import OwnPool as OwnPool

__all__ = ["OwnPool", "from_labels", "from_mesh"]
