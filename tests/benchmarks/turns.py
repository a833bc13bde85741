"""Work of several sides, timed in turns, so that what else the machine does meets all alike."""

import statistics
import time
from collections.abc import Callable, Mapping

Sides = Mapping[str, Callable[[], object]]
Times = dict[str, list[float]]


def in_turns(sides: Sides, rounds: int, warm: int = 1) -> Times:
    """Return the seconds of each side, a round after the other; the first `warm` are left out."""
    times: Times = {name: [] for name in sides}
    for turn in range(warm + rounds):
        for name, work in sides.items():
            start = time.perf_counter()
            work()
            if turn >= warm:
                times[name].append(time.perf_counter() - start)
    return times


def ratios(peer: list[float], own: list[float]) -> list[float]:
    """Return how many times as long a peer took, round by round."""
    return [theirs / mine for theirs, mine in zip(peer, own, strict=True)]


def rate(items: float, seconds: list[float]) -> float:
    """Return items a second in the median round."""
    return items / statistics.median(seconds)
