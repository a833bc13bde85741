"""A stranger's file in a child process with limits of time, memory and everything else.

`session` is the parent's side, `child` the confined one, `wire` what they say to each other.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
