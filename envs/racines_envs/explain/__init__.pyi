from .explanation import Explanation as Explanation
from .explanation import Shown as Shown
from .explanation import write_explanation as write_explanation
from .run import SCHEMA as SCHEMA
from .run import ExplainConfig as ExplainConfig
from .run import collect as collect
from .run import explain as explain

__all__ = [
    "ExplainConfig",
    "Explanation",
    "Shown",
    "SCHEMA",
    "collect",
    "explain",
    "write_explanation",
]
