from .run import Check as Check
from .run import Validation as Validation
from .run import to_json as to_json
from .run import validate as validate

__all__ = ["Check", "Validation", "to_json", "validate"]
