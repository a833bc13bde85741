"""How good an agent is: episodes from fixed sets of starts, judged by truth and by grader.

`run` goes through them, `measures` computes the metrics, `agent_specs` finds what is judged.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
