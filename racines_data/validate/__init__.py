"""Checking a built dataset: every byte, every row, and what the rows say together.

`run` goes through the configs; each other module is one kind of check. A check returns what it
found, or raises `RacinesError` with what is wrong.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
