from .command import app as app
from .command import evaluate as evaluate
from .command import main as main
from .command import root as root
from .command import train as train

__all__ = ["app", "evaluate", "main", "root", "train"]
