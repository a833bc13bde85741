"""Anybody's recording, by a mapping instead of code: tables of poses, with images of any kind.

    mapping ──> inputs, rows ──> poses, clocks ──> sweeps ──> doubts ──> source ──> trajectories
                                 pictures, region ─┘            └──> sheet

`mapping` says what there is to say; `inputs` opens files and nothing outside their folder; `rows`
reads tables; `poses` makes rigid transforms of their columns; `pictures` reads images, videos and
arrays; `sweeps` puts them together; `doubts` says what looks wrong; `propose` guesses a mapping.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
