from .model import Student as Student
from .model import StudentConfig as StudentConfig

__all__ = ["Student", "StudentConfig"]
