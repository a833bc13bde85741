"""From simulation to reality: what judges that saw simulated patients alone say of real frames.

`frames` reads real echo, `sectors` and `controls` lay it out and spoil it; `acceptance`, `ejection`
and `report` measure, `charts` and `figures` draw.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
