"""How far a number can be relied on: intervals, and the figures of every item that they rest on.

`bootstrap` resamples one training's figures; `intervals` covers units and trainings alike, and
the differences of two methods; `evidence` keeps what scores rest on in a file beside them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
