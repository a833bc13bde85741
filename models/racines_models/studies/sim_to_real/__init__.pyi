from .frames import read_real_echo as read_real_echo
from .report import measure as measure

__all__ = ["measure", "read_real_echo"]
