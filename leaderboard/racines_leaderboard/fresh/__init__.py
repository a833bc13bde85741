"""Fresh draws: entries scored at poses and from starts that nobody has seen, beside public figures.

`rounds` keeps a board's committed secrets, `frames` draws its test split anew, `compare` holds an
entry to the truth drawn again, `draws` scores it in secret, `flags` says what does not fit.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
