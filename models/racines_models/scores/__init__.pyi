from .plugin import Metric as Metric
from .scorer import Scorer as Scorer
from .scorer import ScoresConfig as ScoresConfig
from .scoring import Scores as Scores
from .scoring import score as score

__all__ = ["Metric", "Scorer", "Scores", "ScoresConfig", "score"]
