"""What can be chosen of a replay, and the words that name one on the command line."""

import math
from dataclasses import dataclass
from pathlib import Path

from racines_data.errors import RacinesError
from racines_data.manifest import check_split

PREFIX = "replay:"
LABEL, POSE = "label", "pose"
REFUSE, MASK = "refuse", "mask"
ALL, OWN_SPLIT = "all", "split"
_CHOICES = {
    "judged_by": ("", LABEL, POSE),
    "frames": (ALL, OWN_SPLIT),
    "beyond": (REFUSE, MASK),
}
FARTHEST = 1e4
"""No recording is this long: any distance."""
_POSITIVE = ("within", "within_degrees", "step", "step_degrees", "turn", "phase", "max_steps")
_NOT_NEGATIVE = ("reach", "beat_seconds")


@dataclass(frozen=True)
class ReplayConfig:
    """Where episodes start, how far a step goes, what can be reached, and what counts as success.

    Lengths are in mm; in pixels where a dataset says that it has no millimetre scale.
    """

    goal: str = ""
    """The frame to find, `TRAJECTORY:FRAME`, instead of a view."""
    judged_by: str = ""
    """`label`: the nearest recorded frame bears the view's label; `pose`: the probe is within
    `within` and `within_degrees` of the goal. If empty: by label for a view, by pose for a goal."""
    within: float = 5.0
    """Greatest distance from the goal that is a hit by pose."""
    within_degrees: float = 5.0
    """Greatest turn from the goal that is a hit by pose, degrees."""
    split: str = "train"
    """Whose frames episodes start from."""
    frames: str = ALL
    """What can be walked through: `all` recorded frames, or those of the `split` alone."""
    session: str = ""
    """Only this recording session; all of them if empty, as one body in one frame of reference."""
    start: tuple[float, float] = (0.0, FARTHEST)
    """Least and greatest distance of a start from the goal."""
    start_degrees: tuple[float, float] = (0.0, 180.0)
    """Least and greatest turn of a start from the goal, degrees."""
    step: float = 3.0
    """A unit step along an axis of the probe."""
    step_degrees: float = math.degrees(0.06)
    """A unit step about an axis of the probe, degrees; 0.06 rad."""
    turn: float = 70.0
    """What a turn by one radian weighs against a shift: the nearest pose, and `reach`, are in the
    distance sqrt(shift² + (turn · 2 sin(angle / 2))²)."""
    reach: float = 0.0
    """A step to a pose farther than this from every recorded one is refused; if 0 it is the longest
    unit step and half the gap between successive frames that 19 in 20 keep within."""
    beyond: str = REFUSE
    """Of steps beyond: `refuse`, the probe stays; `mask`, it does too, and the observation has an
    `action_mask` that tells beforehand."""
    phase: float = 20.0
    """What half a beat weighs against a shift, in choosing the nearest frame; where there are
    cardiac phases."""
    beat_seconds: float = 1.0
    """A beat, s, where there are phases; a step takes 0.1 s. At 0 the heart stands at phase 0."""
    max_steps: int = 200
    """Steps after which an episode ends."""

    def __post_init__(self) -> None:
        """Refuse what is out of range, by name."""
        check_split(self.split)
        for name, known in _CHOICES.items():
            value = getattr(self, name)
            if value not in known:
                words = ", ".join(filter(None, known))
                raise RacinesError(f"replay.{name} is {value!r}: choose one of {words}")
        for names, least in ((_POSITIVE, "more than 0"), (_NOT_NEGATIVE, "0 or more")):
            for name in names:
                value = getattr(self, name)
                if not value >= 0 or (value == 0 and names is _POSITIVE):
                    raise RacinesError(f"replay.{name} is {value}: give {least}")
        for name in ("start", "start_degrees"):
            low, high = getattr(self, name)
            if not 0 <= low <= high:
                raise RacinesError(f"replay.{name} is {[low, high]}: give the least, then the most")


def read_env(spec: str) -> Path:
    """Return the folder of `replay:FOLDER`.

    Raises:
        RacinesError: anything else.
    """
    folder = spec.removeprefix(PREFIX)
    if folder == spec or not folder:
        raise RacinesError(f"env {spec!r}: write {PREFIX}FOLDER, the folder of an imported dataset")
    return Path(folder)
