"""Where trajectories come from; a source is one module and one entry point.

`base` has the protocol, the registry and the card of a source; `phantom` simulates, `release`,
`cactus` and `tracked` read recordings; `folder` and `images` are what these share.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
