"""The published RACINES recordings, as people download them.

`layout` knows the folders and the log files, `source` what is wrong with them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
