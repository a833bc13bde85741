from .generator import OnnxGenerator as OnnxGenerator
from .generator import export_generator as export_generator

__all__ = ["OnnxGenerator", "export_generator"]
