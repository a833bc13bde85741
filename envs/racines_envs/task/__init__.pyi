from .core import ScanCore as ScanCore

__all__ = ["ScanCore"]
