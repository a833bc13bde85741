"""How near the phantom's frames are to real ones, beside two halves of the real ones."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
