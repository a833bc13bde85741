"""One real heart beside the simulated ones: what its surfaces measure over the beat.

`meshes` reads and closes surfaces, `measures` takes volumes and lengths, `report` tables them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
