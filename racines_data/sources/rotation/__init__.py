"""Posed rotations about the apex: images beside one `transforms*.json`, as for radiance fields.

    transforms ──> poses ──> turns (frames of one pose: the phases of a beat) ──> angles ──> splits
    pictures   ──> the image of each frame ─────────────────────────────────────> trajectories

`transforms` reads the file and refuses what is no pose; `pictures` finds the images; `turns` knows
angles about the apex, splits by them and what lies next to what; `source` puts them together.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
