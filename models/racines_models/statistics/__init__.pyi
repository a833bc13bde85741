from .bootstrap import LEVEL as LEVEL
from .bootstrap import Estimate as Estimate
from .bootstrap import bootstrap_mean as bootstrap_mean
from .bootstrap import bootstrap_median as bootstrap_median
from .bootstrap import jackknife as jackknife
from .bootstrap import jackknife_all as jackknife_all
from .bootstrap import median as median
from .bootstrap import wilson as wilson
from .evidence import Evidence as Evidence
from .evidence import Figures as Figures
from .evidence import figure as figure

__all__ = [
    "LEVEL",
    "Estimate",
    "Evidence",
    "Figures",
    "bootstrap_mean",
    "bootstrap_median",
    "figure",
    "jackknife",
    "jackknife_all",
    "median",
    "wilson",
]
