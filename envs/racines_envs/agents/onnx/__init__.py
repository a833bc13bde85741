"""Policies as ONNX files: `policy` writes one, reads and checks one, and acts with it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
