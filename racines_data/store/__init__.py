"""The training store: one memory-mapped Arrow file, served in whole batches of tensors.

`frames` reads it and feeds PyTorch; `sweeps` walks the dataset by trajectory, writes the store and
makes it again from the shards.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
