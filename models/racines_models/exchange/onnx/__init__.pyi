from .export import export_generator as export_generator
from .generator import OnnxGenerator as OnnxGenerator

__all__ = ["OnnxGenerator", "export_generator"]
