"""The RACINES dataset: sources, the simulated phantom, building, loading, checking.

Shared by all rooms: `schema`, `views`, `geometry`, `imaging`, `config`, `errors`, `files`,
`manifest`. What takes seconds to import (torch, datasets) is imported when it is first used.
"""

import lazy_loader

from racines_data import renamed
from racines_data.load import load as load  # not lazily: the module of that name would hide it

renamed.install()
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
