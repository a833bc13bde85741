from .run import SCHEMA as SCHEMA
from .run import ExplainConfig as ExplainConfig
from .run import Explanation as Explanation
from .run import Shown as Shown
from .run import collect as collect
from .run import explain as explain
from .run import write_explanation as write_explanation

__all__ = [
    "ExplainConfig",
    "Explanation",
    "Shown",
    "SCHEMA",
    "collect",
    "explain",
    "write_explanation",
]
