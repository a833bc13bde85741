from .plugin import Metric as Metric
from .scoring import Scorer as Scorer
from .scoring import Scores as Scores
from .scoring import ScoresConfig as ScoresConfig
from .scoring import score as score

__all__ = ["Metric", "Scorer", "Scores", "ScoresConfig", "score"]
