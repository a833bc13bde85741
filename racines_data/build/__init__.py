"""Building a dataset: one writer, whatever the source.

A source's units are made in worker processes and staged (`staging`), divided into splits
(`splits`), packed into shards and the store (`writer`, `shards`), and sealed with canonical frames
(`canonical`). `dataset` is the way in.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
