from .bootstrap import Estimate as Estimate
from .bootstrap import bootstrap_mean as bootstrap_mean
from .bootstrap import jackknife as jackknife
from .bootstrap import jackknife_all as jackknife_all
from .bootstrap import median as median
from .bootstrap import wilson as wilson
from .evidence import Evidence as Evidence
from .evidence import Figures as Figures
from .evidence import figure as figure
from .evidence import write_scores as write_scores
from .intervals import LEVEL as LEVEL
from .intervals import Interval as Interval
from .intervals import Replicates as Replicates
from .intervals import interval as interval
from .intervals import mean_interval as mean_interval
from .intervals import median_interval as median_interval
from .intervals import rate_interval as rate_interval
from .sets import set_replicates as set_replicates
from .sets import set_replicates_all as set_replicates_all

__all__ = [
    "LEVEL",
    "Estimate",
    "Evidence",
    "Figures",
    "Interval",
    "Replicates",
    "bootstrap_mean",
    "figure",
    "interval",
    "jackknife",
    "jackknife_all",
    "mean_interval",
    "median",
    "median_interval",
    "rate_interval",
    "set_replicates",
    "set_replicates_all",
    "wilson",
    "write_scores",
]
