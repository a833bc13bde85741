from .measures import heart_measures as heart_measures
from .report import compare as compare

__all__ = ["compare", "heart_measures"]
