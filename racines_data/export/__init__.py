"""Other people's formats: the RACINES release, LeRobot; Minari's is of `racines_envs.recordings`.

A format is one module with one function `export`, and one entry point of `racines.exporters`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
