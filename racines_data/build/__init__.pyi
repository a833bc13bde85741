from .dataset import FORMAT as FORMAT
from .dataset import DataConfig as DataConfig
from .dataset import build as build
from .dataset import make_multi_phantom as make_multi_phantom
from .dataset import make_source as make_source
from .dataset import peak_memory as peak_memory
from .dataset import read_data_section as read_data_section
from .dataset import recipe_of as recipe_of

__all__ = [
    "DataConfig",
    "FORMAT",
    "build",
    "make_multi_phantom",
    "make_source",
    "peak_memory",
    "read_data_section",
    "recipe_of",
]
