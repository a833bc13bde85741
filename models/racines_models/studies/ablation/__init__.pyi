from .run import ablate as ablate

__all__ = ["ablate"]
