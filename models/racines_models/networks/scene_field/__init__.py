"""The scene field's network.

Voxels (`field`) are sampled along the probe's beams (`probe`) and decoded to an image (`echo`).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
