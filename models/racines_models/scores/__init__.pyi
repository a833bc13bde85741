from .judge import Scorer as Scorer
from .judge import ScoresConfig as ScoresConfig
from .plugin import Metric as Metric
from .scoring import Scores as Scores
from .scoring import score as score

__all__ = ["Metric", "Scorer", "Scores", "ScoresConfig", "score"]
