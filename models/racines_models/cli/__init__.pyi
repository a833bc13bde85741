from .commands import register as register

__all__ = ["register"]
