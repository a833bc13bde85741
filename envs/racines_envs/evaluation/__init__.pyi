from .agent_specs import check_view as check_view
from .run import SCHEMA as SCHEMA
from .run import Evaluation as Evaluation
from .run import EvaluationConfig as EvaluationConfig
from .run import Prepared as Prepared
from .run import evaluate as evaluate
from .run import prepare as prepare
from .run import record_trace as record_trace
from .run import reference_steps as reference_steps
from .run import start_seeds as start_seeds
from .run import write_evaluation as write_evaluation
from .trainings import Training as Training
from .trainings import find_trainings as find_trainings
from .trainings import published_run as published_run

__all__ = [
    "Evaluation",
    "EvaluationConfig",
    "Prepared",
    "SCHEMA",
    "Training",
    "check_view",
    "evaluate",
    "find_trainings",
    "prepare",
    "published_run",
    "record_trace",
    "reference_steps",
    "start_seeds",
    "write_evaluation",
]
