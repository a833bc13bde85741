from .registry import Exporter as Exporter
from .registry import exporter_names as exporter_names
from .registry import load_exporter as load_exporter

__all__ = ["Exporter", "exporter_names", "load_exporter"]
