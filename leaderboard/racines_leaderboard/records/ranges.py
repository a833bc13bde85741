"""What a metric can be: its range, its interval, its n. A record beyond it is refused.

This is no proof that a value is true, which recomputing alone gives; it is what no honest
computation can return, whatever it was given.
"""

import functools
import math
import re
from collections.abc import Iterator
from typing import Any

from racines_data.errors import RacinesError

ENDS = ("value", "low", "high")
CLOSE = 1e-9
"""What the last bits of a sum may differ by, relative."""
RATES = (
    r"(precision|recall|coverage)(_grader)?|(view|grade)_agreement(_truth)?|copies(_truth)?"
    r"|distinct|success_\w+|spl(_iqm)?|return_without_success|out_of_support|expert_\w+"
    r"|declared|false_declarations|reached|disturbed_\w+|dice(_\w+)?"
)
AMOUNTS = (
    r"fid(_grader)?|density(_grader)?|pose_error_mm(_view)?(_truth)?|(view_)?position_error|seconds"
    r"|(position_error|seconds)_(median|(upper_)?quartile)"
    r"|(episode_)?steps(_iqm|_median)?|(peak|mean)_force|violations|latency|images_per_second_\d+"
    r"|arm_hits|seconds_to_adapt|[gl][pl]e|(drift|step)_mm"
    r"|(feature_distance|fid)_(neighbour|train)|feature_distance"
)
ANGLES = (
    r"pose_error_deg(_view)?(_truth)?|(view_)?rotation_error(_median|_(upper_)?quartile)?"
    r"|(drift|step)_deg"
)
GRADES = r"grade_error(_all)?(_truth)?|final_grade(_iqm)?"
RANGES = {
    RATES: (0.0, 1.0),
    AMOUNTS: (0.0, math.inf),
    ANGLES: (0.0, 180.0),
    GRADES: (0.0, 10.0),
    r"diversity(_truth)?|nearest_train(_truth)?": (0.0, 255.0),
    r"(ms_)?ssim|ssim_(neighbour|train)": (-1.0, 1.0),
    r"psnr(_neighbour|_train)?": (0.0, 100.0),
    r"score": (-math.inf, 1.0),
    r"return(_iqm)?": (-math.inf, math.inf),
    # Unbiased, so below 0 by chance: by about 2 k / n, with k the kernel of an image with itself.
    r"kid(_neighbour|_train)?": (-0.1, math.inf),
    r"kid_grader": (-1.0, math.inf),
}
"""Least and most by name. Of a metric with a symmetric interval only the value is held to it."""
SYMMETRIC = re.compile(r"kid(_grader|_neighbour|_train)?")


def range_of(name: str) -> tuple[float, float]:
    """Return the least and the most that a metric can be; a plug-in's by what it declares."""
    if (own := _own_range(name)) is not None:
        return own
    from racines_models.scores.plugin import installed_metrics

    for metric in installed_metrics():
        if metric.name == name:
            return metric.minimum, metric.maximum
    return -math.inf, math.inf


@functools.lru_cache(4096)
def _own_range(name: str) -> tuple[float, float] | None:
    """Return the range of a metric that is not a plug-in's."""
    matching = (ends for pattern, ends in RANGES.items() if re.fullmatch(pattern, name))
    return next(matching, None)


def faults(name: str, metric: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Give what of one metric cannot be: the field, and why."""
    value, low, high = (metric[key] for key in ENDS)
    if value is None:
        if low is not None or high is not None:
            yield "value", "there is an interval of no value"
        return
    if metric["n"] < 1:
        yield "n", f"a value of {value:g} from no item"
    if (low is None) != (high is None):
        yield "low" if low is None else "high", "one end of the interval is missing"
    elif low is not None:
        slack = CLOSE * max(1.0, abs(value))
        if not low - slack <= value <= high + slack:
            yield "value", f"{value:g} lies outside its interval, {low:g} to {high:g}"
    least, most = range_of(name)
    for key in ENDS[:1] if SYMMETRIC.fullmatch(name) else ENDS:
        number = metric[key]
        if number is not None and not least - CLOSE <= number <= most + CLOSE:
            yield key, f"{number:g} is beyond what it can be, {least:g} to {most:g}"


def check_possible(scores: dict[str, Any], where: str) -> None:
    """Refuse scores with a metric that cannot be.

    Raises:
        RacinesError: the first, with its field and what was expected.
    """
    groups = {"metrics": scores["metrics"]}
    for kind in ("by_seed", "by_pathology", "by_stratum"):
        groups |= {f"{kind}.{name}": each for name, each in scores.get(kind, {}).items()}
    for place, metrics in groups.items():
        for name, metric in metrics.items():
            for field, reason in faults(name, metric):
                raise RacinesError(f"{where}: {place}.{name}.{field}: {reason}; score it again")
