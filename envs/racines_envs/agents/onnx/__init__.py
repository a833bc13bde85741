"""Policies as ONNX files: `export` writes one, `policy` reads one, checks it and acts with it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
