"""Turns of a probe about the apex: what frames belong to one, its angle, and splits by angle.

The axis is the mean direction of the beams; a turn's angle is that of the image's x about it.
Planes half a turn apart are one plane, mirrored, so that angles count modulo 180 degrees and a
circle of that length is what is divided:

    interpolation   several narrow blocks, each in the middle of as many turns as the next
    gap             one wide block, where it holds about the share of the turns that is wanted, with
                    some training turns on both of its sides, the first close to its edge

Turns cluster: neighbours are near-copies, so that a block is held out whole, as all turns in a
range of angles. Blocks for validation lie apart from those for test.
"""

from dataclasses import dataclass

import numpy as np

from racines_data.errors import RacinesError

HALF = 180.0
"""Degrees after which a plane is the same again, mirrored."""
INTERPOLATION, GAP = "interpolation", "gap"
MODES = (INTERPOLATION, GAP)
_WANDERS = 0.25
"""Share of an image's height that the apex may lie from its mean place."""
_LEANS = 30.0
"""Degrees that a beam may lie from the mean of all."""
_EDGE = 0.25
"""Share of a gap's width up to which the nearest training turn from an edge costs nothing."""
_BESIDE = 0.05
"""Share of the turns that lie on each side of a gap, no farther away than it is wide, at least."""
_FEWEST = 6
"""Turns without which there is nothing to split."""


@dataclass(frozen=True)
class Turn:
    """The frames of one pose, in order of the beat."""

    frames: np.ndarray
    """(P,) places in the file of poses."""
    matrix: np.ndarray
    """(4, 4) pose of the image in pixels, as the file has it."""


def group_turns(matrices: np.ndarray, times: np.ndarray | None, where: str) -> list[Turn]:
    """Return the turns of (N, 4, 4) poses in the order in which each is first seen.

    Frames of one turn have one pose, to the last bit; they are put in the order of their times.

    Raises:
        RacinesError: turns with different numbers of frames, or two frames of one time.
    """
    members: dict[bytes, list[int]] = {}
    for index, matrix in enumerate(matrices):
        members.setdefault((matrix + 0.0).tobytes(), []).append(index)
    counts = np.array([len(each) for each in members.values()])
    values, often = np.unique(counts, return_counts=True)
    usual = int(values[often.argmax()])
    for own in members.values():
        if len(own) != usual:
            raise RacinesError(
                f"{where}: frames[{own[0]}].transform_matrix: {len(own)} frames have this pose, "
                f"where {usual} frames have one elsewhere: every turn needs as many phases"
            )
    turns = [
        Turn(_in_order(np.array(own), times, where), matrices[own[0]]) for own in members.values()
    ]
    return turns


def _in_order(frames: np.ndarray, times: np.ndarray | None, where: str) -> np.ndarray:
    if times is None:
        return frames
    ordered = frames[np.argsort(times[frames], kind="stable")]
    twice = np.flatnonzero(np.diff(times[ordered]) == 0)
    if len(twice):
        raise RacinesError(
            f"{where}: frames[{ordered[twice[0] + 1]}].time: two frames of one turn have the time "
            f"{times[ordered[twice[0]]]:g}"
        )
    return ordered


def tips(matrices: np.ndarray, width: float, plane: float) -> np.ndarray:
    """Return the (N, 3) places of the images' top middle, pixels, of (N, 4, 4) poses."""
    top = np.array([width / 2, 0.0, plane])
    return matrices[:, :3, :3] @ top + matrices[:, :3, 3]


def check_apex(matrices: np.ndarray, size: tuple[int, int], plane: float, where: str) -> None:
    """Refuse poses that do not turn about one apex: read another way, they mostly are others'.

    Raises:
        RacinesError: the apex wanders or beams lean apart; with what would fit, if anything does.
    """
    if (fault := _off_apex(matrices, size, plane)) is None:
        return
    inverted = np.linalg.inv(matrices)
    said = ""
    if _off_apex(inverted, size, plane) is None:
        said = "; inverted, the matrices would fit: they map the world to the image: invert them"
    raise RacinesError(f"{where}: transform_matrix: no turns about an apex: {fault}{said}")


def _off_apex(matrices: np.ndarray, size: tuple[int, int], plane: float) -> str | None:
    at = tips(matrices, size[0], plane)
    away = float(np.linalg.norm(at - at.mean(0), axis=-1).max())
    if away > _WANDERS * size[1]:
        return f"the image's top middle wanders by {away:.0f} of {size[1]} pixels"
    beams = matrices[:, :3, 1]
    mean = beams.mean(0)
    if (length := float(np.linalg.norm(mean))) < 0.1:
        return "beams point all ways"
    lean = float(np.degrees(np.arccos(np.clip(beams @ (mean / length), -1, 1))).max())
    return f"beams lean {lean:.0f}° from their mean" if lean > _LEANS else None


def angles(matrices: np.ndarray) -> np.ndarray:
    """Return the (N,) angles about the apex, degrees in [0, 180), of (N, 4, 4) poses."""
    axis = matrices[:, :3, 1].mean(0)
    axis = axis / np.linalg.norm(axis)
    first = np.eye(3)[np.abs(axis).argmin()]  # of the world's axes, the least along it
    first = first - axis * (first @ axis)
    first = first / np.linalg.norm(first)
    across = matrices[:, :3, 0]
    found = np.degrees(np.arctan2(across @ np.cross(axis, first), across @ first))
    return np.mod(np.mod(found, HALF) + HALF, HALF)


def apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the degrees, 0 to 90, between angles that count modulo 180."""
    return np.abs(np.mod(one - other + HALF / 2, HALF) - HALF / 2)


def to_nearest(of: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the (N,) degrees from (N,) angles to the nearest of (M,) others, M > 0."""
    return apart(of[:, None], others[None]).min(1)


def split_turns(
    at: np.ndarray, mode: str, blocks: int, width: float, gap: float, share: float
) -> np.ndarray:
    """Return (N,) names of splits of turns at (N,) angles, degrees.

    Args:
        at: Angles of the turns.
        mode: One of `MODES`.
        blocks: Narrow blocks that are held out for test; half as many are for validation.
        width: Degrees of a narrow block.
        gap: Degrees of the wide one.
        share: Share of the turns that the wide one should hold; there are no more narrow ones than
            that share of turns.

    Raises:
        RacinesError: too few turns, no place for a gap, or settings that leave nothing to train on.
    """
    if len(at) < _FEWEST:
        raise RacinesError(f"{len(at)} turns: splits by turn need {_FEWEST} or more")
    blocks = max(1, min(blocks, int(share * len(at))))
    test = _gap(at, gap, share) if mode == GAP else _blocks(at, at, blocks, width)
    far = ~test & (to_nearest(at, at[test]) > 2 * width)
    validation = np.zeros(len(at), bool)
    if far.any():
        validation = _blocks(at, at[far], max(1, blocks // 2), width) & far
    train = ~test & ~validation
    if train.sum() < 2:
        raise RacinesError(
            f"{int(test.sum())} of {len(at)} turns for test leave {int(train.sum())} to train on: "
            "set blocks or width lower"
        )
    return np.where(test, "test", np.where(validation, "validation", "train"))


def _blocks(at: np.ndarray, among: np.ndarray, blocks: int, width: float) -> np.ndarray:
    """Return (N,) whether turns lie in a block about the middle of equal parts of some turns."""
    ordered = np.sort(among)
    parts = np.array_split(ordered, min(blocks, len(ordered)))
    middles = np.array([part[len(part) // 2] for part in parts])
    return apart(at[:, None], middles[None]).min(1) <= width / 2


def _gap(at: np.ndarray, gap: float, share: float) -> np.ndarray:
    """Return (N,) whether turns lie in the one wide block; of equally good places, the first."""
    best, found = np.inf, None
    for start in np.sort(at):
        inside = np.mod(at - start, HALF) < gap
        others = at[~inside]
        sides = np.mod(start - others, HALF), np.mod(others - start - gap, HALF)
        if min(int((side < gap).sum()) for side in sides) < max(1, int(_BESIDE * len(at))):
            continue
        late = max(float(side.min()) for side in sides) / gap
        cost = abs(float(inside.mean()) - share) + max(0.0, late - _EDGE)
        if cost < best:
            best, found = cost, inside
    if found is None:
        raise RacinesError(
            f"no {gap:g} degrees have turns on both sides to train on: set gap lower"
        )
    return found
