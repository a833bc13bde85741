"""The scanning task on batches: states, actions, rewards, starts, and the core that steps them.

`core` is the one loop body; `tasks` says what each task is, `starts` where it begins.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
