"""The commands `racines train agent`, `racines eval agent` and what stands around them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
