"""What looks at images for an environment, and checks of what a backend, grader or force gave.

Shapes and types are looked at every step: that costs nothing. Numbers are looked at at once on the
CPU; on an accelerator they are asserted there, so that no step waits for the device.
"""

from typing import Protocol, runtime_checkable

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, rotation_6d
from racines_data.imaging import IMAGE_SIZE, ImageSource
from racines_data.world import Workspace, World


class Encoder(Protocol):
    """A frozen network that an agent looks through."""

    size: int
    """Numbers an image."""

    def __call__(self, images: Tensor) -> Tensor:
        """Return (B, size) float32 features of (B, 128, 128) uint8 images."""
        ...


@runtime_checkable
class ForceSource(Protocol):
    """Says what the wrist sensor feels at a pose."""

    def wrench(self, pose: Pose) -> Tensor:
        """Return (B, 6) force, N, and torque, N·m, in the probe's axes, of a probe at rest."""
        ...


@runtime_checkable
class DrawsScenes(Protocol):
    """A source of images that draws whatever scene the rows are in."""

    def of(self, scene: World) -> ImageSource:
        """Return the source of a scene's images; it is asked for one of each row."""
        ...


@runtime_checkable
class KnowsSupport(Protocol):
    """A source of images that knows where it has something to show."""

    def out_of_support(self, parameters: Tensor) -> Tensor:
        """Return (B,) bool: what is shown at (B, 12) parameters was made far from there."""
        ...


@runtime_checkable
class TellsFrames(Protocol):
    """A scene of recorded frames, which says what is shown."""

    def told(self, pose: Pose) -> dict[str, Tensor]:
        """Return the store's row of each of (B,) poses' frame, and its distance, m."""
        ...


@runtime_checkable
class KnowsWays(Protocol):
    """A world in which the straight way to the goal may be closed, and that knows another."""

    def waypoint(self, pose: Pose) -> Pose:
        """Return (B,) poses to go to next, on the shortest open ways from (B,) poses to a hit."""
        ...

    def steps_left(self, pose: Pose) -> Tensor:
        """Return the (B,) lengths of these ways, in unit steps."""
        ...


@runtime_checkable
class MasksSteps(Protocol):
    """A world that may want the steps that it would refuse to be told beforehand."""

    masks: bool
    """Whether it does."""


def box_of(space: Workspace) -> tuple[Tensor, Tensor]:
    """Return the middle of a workspace's box and half its size, (3,) m each."""
    low, high = space.position_min, space.position_max
    return (high + low) / 2, (high - low) / 2


def encode_pose(pose: Pose, centre: Tensor, half: Tensor) -> Tensor:
    """Return (B, 9): positions in a box of `box_of`, -1 to 1, then the continuous rotation."""
    at, turned = pose
    return torch.cat([(at - centre) / half, rotation_6d(turned)], -1).clamp(-1.0, 1.0)


def check_drawn(images: object, count: int, source: object) -> Tensor:
    """Return the images if they are (count, 128, 128) uint8; else refuse what `source` drew."""
    who = f"backend {type(source).__name__}"
    if not isinstance(images, Tensor):
        raise RacinesError(f"{who}: generate gave {type(images).__name__}: give a torch.Tensor")
    if images.dtype != torch.uint8:
        nan = images.is_floating_point() and not bool(torch.isfinite(images).all())
        kind = f"{images.dtype}{' with NaN or infinity' if nan else ''}"
        raise RacinesError(f"{who}: generate gave {kind}: give uint8 gray levels 0-255")
    if images.shape != (count, IMAGE_SIZE, IMAGE_SIZE):
        raise RacinesError(
            f"{who}: generate gave shape {tuple(images.shape)} for {count} poses: give "
            f"({count}, {IMAGE_SIZE}, {IMAGE_SIZE})"
        )
    return images


def check_judged(p: Tensor, grade: Tensor, count: int, labels: int, grader: object) -> None:
    """Check that a grader gave (count, labels) probabilities and (count,) grades, all finite."""
    who = f"grader {type(grader).__name__}"
    if p.shape != (count, labels) or grade.shape != (count,):
        raise RacinesError(
            f"{who}: gave probabilities {tuple(p.shape)} and grades {tuple(grade.shape)} of "
            f"{count} images: give ({count}, {labels}) and ({count},)"
        )
    check_finite(p, f"{who}: probabilities")
    check_finite(grade, f"{who}: grades")


def check_finite(values: Tensor, what: str) -> None:
    """Check that all values are finite, or name the first row with NaN or infinity."""
    finite = torch.isfinite(values)
    if not all_hold(finite):
        row = int((~finite).nonzero()[0, 0])
        raise RacinesError(f"{what}: row {row} is NaN or infinite: give numbers")


def all_hold(conditions: Tensor) -> bool:
    """Return whether all are true; on an accelerator that is asserted there, and taken as true."""
    if conditions.device.type == "cpu":
        return bool(conditions.all())
    torch.ops.aten._assert_async(conditions.all())
    return True
