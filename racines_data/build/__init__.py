"""Building a dataset: one writer, whatever the source.

A source's units are made in worker processes and staged (`staging`), divided into splits, packed
into shards and a store, and sealed with canonical frames, by which a rebuild on another processor
is recognised (`writer`). `dataset` is the way in.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
