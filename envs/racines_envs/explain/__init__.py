"""Why an agent moved as it did: attributions along episodes, scored, and beside the truth."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
