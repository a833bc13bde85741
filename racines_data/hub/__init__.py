"""The Hugging Face Hub: `fetch` downloads a tagged version and checks it, `push` publishes one."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
