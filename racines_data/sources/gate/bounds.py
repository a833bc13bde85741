"""What is plausible of a source's numbers: the defaults, a source's own, and a dataset's."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from racines_data.errors import RacinesError

READING = "reading"
"""What a mapping of the source `table` is inferred to have taken for something else."""
OPINIONS = (
    "looks-up",
    "force-sign",
    "controls",
    "frozen",
    "stale-pose",
    "sector",
    "saturated",
    "units-mixed",
    READING,
)
"""Checks that infer a mistake and could be wrong about a source; each can be allowed by name."""


@dataclass(frozen=True)
class Bounds:
    """What is plausible of one source; a source that differs has its own as attribute `bounds`."""

    reach: float = 2.0
    """Farthest that the probe can be from the frame's origin, m: a robot's base."""
    nearest: float = 0.001
    """A whole trajectory nearer to the origin than this, m, is in another unit; 0 for none."""
    force: float = 200.0
    """Largest force along an axis, N; half of it is too much as the median of a trajectory."""
    torque: float = 50.0
    """Largest torque about an axis, N·m."""
    speed: float = 10.0
    """Largest commanded velocity along an axis, m/s."""
    spin: float = 30.0
    """Largest commanded velocity about an axis, rad/s."""
    shortest: float = 1e-3
    """Shortest plausible median time between frames, s."""
    longest: float = 5.0
    """Longest plausible median time between frames, s."""
    repeats: bool = False
    """Whether a time may stand twice (a coarse clock)."""
    clock: bool = True
    """Whether there are times at all; without a clock all are NaN."""
    upright: bool = True
    """Whether z of the frame points up and the probe scans from above. False for a tracker's."""
    sensor: bool = True
    """Whether forces are those on the probe in its own axes: contact pushes along -z."""
    allow: tuple[str, ...] = ()
    """Names of `OPINIONS` that are not held against this source."""

    def __post_init__(self) -> None:
        """Refuse a name that is none of the opinions."""
        for name in self.allow:
            if name not in OPINIONS:
                raise RacinesError(f"data.allow {name!r}: choose of {', '.join(OPINIONS)}")


def bounds_of(source: Any, allow: Sequence[str] = ()) -> Bounds:
    """Return the bounds of a source, with what a user allows beside what it allows itself.

    Raises:
        RacinesError: its `bounds` are no `Bounds`, or a name allowed is none.
    """
    bounds = getattr(source, "bounds", Bounds())
    if not isinstance(bounds, Bounds):
        raise RacinesError(
            f"source {source.name}: its `bounds` are {type(bounds).__name__}; give a "
            "racines_data.sources.gate.Bounds"
        )
    return replace(bounds, allow=tuple(sorted({*bounds.allow, *allow})))


def to_manifest(bounds: Bounds) -> dict[str, Any]:
    """Return what a manifest holds of the bounds: nothing where they are the usual ones."""
    if bounds == Bounds():
        return {}
    return {"bounds": asdict(bounds) | {"allow": list(bounds.allow)}}


def manifest_bounds(manifest: Mapping[str, Any]) -> Bounds:
    """Return the bounds of a dataset: the manifest's, or those of our source of that name."""
    if held := manifest.get("bounds"):
        known = {field.name for field in fields(Bounds)}
        given = {key: value for key, value in held.items() if key in known}
        return Bounds(**{**given, "allow": tuple(given.get("allow", ()))})
    # A dataset of tracked sweeps that was made before manifests had bounds.
    return TRACKER if manifest.get("source") == "tracked" else Bounds()


TRACKER = Bounds(reach=10.0, nearest=0.01, upright=False, sensor=False)
"""A tracker's frame: its origin is the tracker, its axes are any, and there are no forces."""
