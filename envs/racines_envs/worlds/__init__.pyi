from .making import find_task as find_task
from .making import make_core as make_core

__all__ = ["find_task", "make_core"]
