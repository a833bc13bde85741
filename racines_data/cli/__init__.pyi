from .data import AsJson as AsJson
from .data import Params as Params
from .data import Profile as Profile
from .data import build as build
from .data import data as data
from .data import validate as validate

__all__ = ["AsJson", "Params", "Profile", "build", "data", "validate"]
