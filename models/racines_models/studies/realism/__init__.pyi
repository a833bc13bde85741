from .report import RealismConfig as RealismConfig

__all__ = ["RealismConfig"]
