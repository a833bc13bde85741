from .bounds import OPINIONS as OPINIONS
from .bounds import Bounds as Bounds
from .bounds import bounds_of as bounds_of
from .bounds import manifest_bounds as manifest_bounds
from .check import Scale as Scale
from .check import check_scales as check_scales
from .check import check_trajectory as check_trajectory
from .check import scale_of as scale_of
from .numbers import LENGTHS as LENGTHS
from .numbers import backward as backward
from .numbers import check_poses as check_poses
from .numbers import likely_unit as likely_unit
from .numbers import rotation_faults as rotation_faults

__all__ = [
    "LENGTHS",
    "OPINIONS",
    "Bounds",
    "Scale",
    "backward",
    "bounds_of",
    "check_poses",
    "check_scales",
    "check_trajectory",
    "likely_unit",
    "manifest_bounds",
    "rotation_faults",
    "scale_of",
]
