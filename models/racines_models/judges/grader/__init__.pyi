from .model import Grader as Grader
from .model import GraderConfig as GraderConfig
from .model import GradeStageConfig as GradeStageConfig
from .model import StageConfig as StageConfig

__all__ = ["GradeStageConfig", "Grader", "GraderConfig", "StageConfig"]
