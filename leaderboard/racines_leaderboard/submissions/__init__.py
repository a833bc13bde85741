"""Submissions: one folder a system, with one YAML and the artefacts that it names."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
