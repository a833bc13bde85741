"""How an agent bears what its training did not show it, one disturbance at a time and all."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
