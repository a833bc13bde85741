"""What an arm is: its links by Denavit and Hartenberg, its limits, and how it holds the probe.

An arm is one file with one `Arm`, and one entry point of the group `racines.robots`. All lengths
are in m, all angles in rad. The base frame is that of the poses: the arm stands at its origin.
"""

from dataclasses import dataclass
from xml.etree.ElementTree import Element, SubElement, tostring

from racines_data.errors import RacinesError
from racines_data.phantom.pacing import FREE as FREE
from racines_data.plugins import Plugins

ROBOTS = Plugins(
    "robot", "racines.robots", ("name", "links", "limits", "speeds", "home", "tool"), "module:ARM"
)
BASE, TIP = "base", "tip"
"""Names of the first and the last link."""


@dataclass(frozen=True)
class Link:
    """A revolute joint and the link after it: Rz(θ) Tz(d) Tx(a) Rx(alpha)."""

    a: float
    d: float
    alpha: float


@dataclass(frozen=True)
class Arm:
    """A serial arm of revolute joints."""

    name: str
    links: tuple[Link, ...]
    limits: tuple[tuple[float, float], ...]
    """Least and greatest angle of each joint."""
    speeds: tuple[float, ...]
    """Greatest speed of each joint, rad/s."""
    home: tuple[float, ...]
    """Joints from which the arm goes to where an episode starts."""
    tool: float
    """From the flange to the tip of the probe, along the flange's z axis, which is the beam's."""
    source: str
    """Where the numbers come from."""

    def __post_init__(self) -> None:
        """Refuse tables that differ in length.

        Raises:
            RacinesError: naming the table.
        """
        for name in ("limits", "speeds", "home"):
            if len(getattr(self, name)) != len(self.links):
                raise RacinesError(
                    f"robot {self.name}: {name} has {len(getattr(self, name))} entries: give one "
                    f"for each of {len(self.links)} links"
                )

    def urdf(self) -> str:
        """Return the arm as URDF, with links of 1 kg: its masses are not told and play no part."""
        robot, count = Element("robot", name=self.name), len(self.links)
        names = [BASE, *(f"link{place}" for place in range(1, count + 1)), TIP]
        for name in names:
            inertial = SubElement(SubElement(robot, "link", name=name), "inertial")
            SubElement(inertial, "mass", value="1")
            SubElement(inertial, "inertia", _INERTIA)
        before = [Link(0.0, 0.0, 0.0), *self.links]
        for place, ((low, high), speed) in enumerate(zip(self.limits, self.speeds, strict=True)):
            joint = _joint(robot, f"joint{place + 1}", "revolute", names, place, before[place])
            SubElement(joint, "axis", xyz="0 0 1")
            told = {"lower": repr(low), "upper": repr(high), "velocity": repr(speed)}
            SubElement(joint, "limit", told, effort="100")
        _joint(robot, "flange", "fixed", names, count, before[count])
        return tostring(robot, encoding="unicode")


_INERTIA = {"ixx": "0.01", "iyy": "0.01", "izz": "0.01", "ixy": "0", "ixz": "0", "iyz": "0"}


def _joint(
    robot: Element, name: str, kind: str, names: list[str], place: int, before: Link
) -> Element:
    """Add a joint between two links, where the link before it ends."""
    joint = SubElement(robot, "joint", name=name, type=kind)
    SubElement(joint, "parent", link=names[place])
    SubElement(joint, "child", link=names[place + 1])
    SubElement(joint, "origin", xyz=f"{before.a!r} 0 {before.d!r}", rpy=f"{before.alpha!r} 0 0")
    return joint


def get_arm(name: str) -> Arm:
    """Return the arm of a name, or of `module:ARM`.

    Raises:
        RacinesError: no such arm.
    """
    return ROBOTS.load(name)
