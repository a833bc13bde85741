"""Replay from data alone: an environment of recorded frames and poses, and of nothing else.

`settings` says what can be chosen, `frames` what is read of a dataset, `index` finds the nearest
recorded pose, `paths` what can be reached, and `world` answers an environment.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
