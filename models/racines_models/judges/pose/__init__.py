"""The pose regressor: one ResNet that reads the probe's pose back from one image."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
