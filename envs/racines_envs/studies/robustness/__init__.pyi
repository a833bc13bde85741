from .disturbances import DISTURBANCES as DISTURBANCES
from .disturbances import Disturbance as Disturbance
from .run import RobustnessConfig as RobustnessConfig
from .run import evaluate_robustness as evaluate_robustness
