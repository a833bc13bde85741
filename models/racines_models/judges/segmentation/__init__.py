"""The segmentation judge: one U-Net that outlines chambers and walls in one image.

`structures` says which labels it knows and what CAMUS calls them, `frames` what it learns from;
`model` outlines, `training` teaches it, `overlap` holds its outlines against others.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
