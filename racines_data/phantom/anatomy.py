"""What an anatomy is: tissues painted in space, named structures, and the views that show them.

A new organ is one file with one function `(seed: int) -> Anatomy`, and one entry point of the group
`racines.anatomies`, which names its views (docs/organs.md); or a folder that was made of meshes or
of a label map (docs/own-anatomy.md).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.phantom.saved import Saved, find_saved, read_saved
from racines_data.views import ANATOMIES, organs

Point = tuple[float, float, float]


def to_point(vector: Tensor) -> Point:
    """Return a (3,) tensor as numbers."""
    x, y, z = vector.tolist()
    return x, y, z


@dataclass(frozen=True)
class Tissue:
    """Acoustic properties of one tissue class."""

    name: str
    echogenicity: float
    """Backscatter, dB relative to myocardium."""
    attenuation: float
    """dB/cm/MHz."""
    speed: float
    """Speed of sound, m/s."""
    density: float
    """kg/m³."""
    texture: float = 0.0
    """Standard deviation of slow (centimetre) variation of the backscatter, dB."""
    grain: float = 0.0
    """Standard deviation of fine (2-3 mm) variation of the backscatter, dB."""
    sheets: bool = False
    """Whether it lies in sheets along its surface, which scatter less along than across."""

    @property
    def impedance(self) -> float:
        """Acoustic impedance, MRayl."""
        return self.speed * self.density * 1e-6


@dataclass(frozen=True)
class Structure:
    """A landmark that a view has to show."""

    name: str
    centre: Point
    """Organ frame, m."""
    radius: float
    """Distance from the image plane at which it is all but lost, m."""


@dataclass(frozen=True)
class ViewSpec:
    """A standard view: the plane, the way it is looked at, and what has to be in it.

    All vectors are in the organ frame.
    """

    name: str
    focus: Point
    """A point of the image plane on the central beam, m."""
    beam: Point
    """Direction of the central beam; made orthogonal to the normal."""
    normal: Point
    """Normal of the image plane, out of the image (the probe's y axis)."""
    structures: tuple[tuple[str, float], ...]
    """Names and weights of the structures that make the view complete."""
    indentation: float = 0.006
    """Depth of the tip under the surface at the nominal pose, m."""
    title: str = ""
    """What people call the view."""


@dataclass(frozen=True)
class Anatomy:
    """An organ in its own frame, and where it lies in the block."""

    name: str
    tissues: tuple[Tissue, ...]
    """Index 0 is the gel around the organ."""
    paint: Callable[[Tensor], Tensor]
    """Maps (M, 3) points of the organ frame, m, to (M,) int64 tissue indices."""
    structures: tuple[Structure, ...]
    views: tuple[ViewSpec, ...]
    axes: tuple[Point, ...]
    """Rows are the organ's axes in the base frame."""
    origin: Point
    """The organ's origin in the base frame, m."""
    home: tuple[float, float, float, float, float, float] = (0.4886, 0.0400, 0.0, 0.0, 0.05, 1.90)
    """Where an operator starts: x, y, m; then (unused) z, two leans and the turn, rad."""
    wander: Point = (0.4886, 0.0400, 0.9)
    """Middle of the random scans: x, y, m, and the turn of the probe, rad."""


def load_anatomy(name: str, seed: int) -> Anatomy:
    """Build an anatomy by its name, by `module:function`, or by the folder of one's own.

    Raises:
        RacinesError: no such anatomy, it cannot be imported, its entry point names other views, or
            a seed is given of a folder, which is one organ.
    """
    folder = None if name in ANATOMIES.names() else find_saved(name)
    if folder is not None:
        if seed:
            raise RacinesError(
                f"anatomy {name}: is one organ, anatomy_seed is {seed}: give 0, and leave out "
                "multi_phantom"
            )
        return _anatomy_of(read_saved(folder))
    anatomy: Anatomy = ANATOMIES.load(name)(seed)
    views, named = tuple(view.name for view in anatomy.views), organs().get(name)
    if named and views != named:
        raise RacinesError(
            f"anatomy {name!r} has the views {', '.join(views)}, and its entry point names "
            f"{', '.join(named)}: write [{','.join(views)}] there"
        )
    return anatomy


def _anatomy_of(saved: Saved) -> Anatomy:
    told, place = saved.told, saved.told["place"]
    views = [
        ViewSpec(**view | {name: tuple(view[name]) for name in ("focus", "beam", "normal")}
                 | {"structures": tuple((name, weight) for name, weight in view["structures"])})
        for view in told["views"]
    ]  # fmt: skip
    return Anatomy(
        name=told["name"],
        tissues=tuple(Tissue(**each) for each in told["tissues"]),
        paint=saved.paint,
        structures=tuple(
            Structure(name, tuple(centre), radius) for name, centre, radius in told["structures"]
        ),
        views=tuple(views),
        axes=tuple(tuple(row) for row in place["axes"]),
        origin=tuple(place["origin"]),
        home=tuple(place["home"]),
        wander=tuple(place["wander"]),
    )


@cache
def anatomy_views(name: str) -> tuple[str, ...]:
    """Return the names of an anatomy's views, in label order."""
    return organs().get(name) or tuple(view.name for view in load_anatomy(name, 0).views)
