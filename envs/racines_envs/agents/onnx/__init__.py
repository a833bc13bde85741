"""Policies as ONNX files: `export` writes one, `policy` acts with one.

`format` says what a file has to hold.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
