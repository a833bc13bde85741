"""The dataset's card: what a reader has to know, written from the manifest at every build.

`markdown` puts the page together from tables and pictures; `croissant` says the same to machines
and to reviewers; `rewrite` renews the card of a dataset that stands.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
