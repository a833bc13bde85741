"""What a task runs in: the phantom, a generator's images, or recorded frames.

`making` puts a core together; `backends` draw; `replay` does, and stands in for a phantom.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
