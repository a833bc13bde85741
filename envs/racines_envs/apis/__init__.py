"""One core behind three interfaces: Gymnasium, Gymnasium's vector environments, TorchRL."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
