"""The commands on the boards, and the `racines` command put together from all four packages."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
