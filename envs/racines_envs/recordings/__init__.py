"""Episodes on disk: `episode_writer` writes them, `rerun` runs them again and checks the poses."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
