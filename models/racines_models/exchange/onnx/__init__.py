"""Generators as ONNX files: `export` writes one, `generator` draws with one.

`format` says what a file has to hold, `file` checks it, `session` runs it.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
