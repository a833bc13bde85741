"""One core behind many interfaces: Gymnasium's, single and vector, TorchRL's, and those of others.

`sb3` and `tianshou` import those libraries, so they are imported by name and not from here.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
