"""Scouts: a short sweep over a patient whom nobody has seen, and the poses that are then asked for.

    view ~ view ~ … ~ view     64 posed frames: all that is known of the patient
      ·      ·       ·         32 poses away from them, in strata of distance to the nearest frame

The sweep goes by all of the patient's views in an order drawn by chance, past each of them twice
and never exactly, as an examiner who looks round does, at a nearly even pace. A pose's distance
from a frame counts millimetres and degrees alike: a turn weighs what it moves a point at half of
the usual depth. Hearts stand still at end diastole, breathed out. All is a function of the patient
and the seed.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import normalize

from racines_data.errors import RacinesError
from racines_data.geometry import (
    Pose,
    axis_angle_to_matrix,
    matmul3,
    orthonormalise,
    parameters_to_pose,
    pose_keys,
    pose_to_parameters,
)
from racines_data.patients.placement import SURFACE
from racines_data.patients.pool import Pool
from racines_data.phantom.acquisition import (
    AcquisitionConfig,
    Draw,
    around,
    coordinates,
    follow,
    limits_of,
    record,
)
from racines_data.phantom.config import PhantomConfig
from racines_data.randomness import derive, sample_seeds, uniform
from racines_data.world import STEP_SECONDS

FRAMES, POSES = 64, 32
"""Frames of a scout, and poses that are asked for."""
STRATA = (0.0, 5.0, 10.0, 15.0, 20.0)
"""Ends of the strata of distance to the nearest frame of the scout, mm; as many poses in each."""
METRES_PER_RADIAN = 0.07
"""What a turn weighs against a shift."""
SCOUTS_VERSION = "0.2.0"
"""Of how scouts and poses are drawn: raise it whenever one of them moves."""
PAST = 6.0
"""Spread of the way-points about a view, mm along and degrees about each axis."""
SWEEPS = AcquisitionConfig(rate=1.0 / STEP_SECONDS)
OPERATORS = 3
CLEAR, SEEN = 0.35, 0.3
"""Clarity of a pose that is asked for, and how far it shows some structure of the heart, 0-1."""
PRESSED = 20.0  # N, the force limit of the tasks
LIFT = 0.0006  # m, spread of the height: the skin is level
CANDIDATES, ROUNDS = 128, 16
"""Poses tried at a time in a stratum, and how often."""
_STREAM, _SPECKLE = 0x5C07, 5


class Scouted(NamedTuple):
    """What P patients showed in their scouts, and at the poses that are asked for."""

    images: Tensor
    """(P, 64, 128, 128) uint8 of the scouts."""
    parameters: Tensor
    """(P, 64, 12) float32 of the scouts, as the sensors measured them."""
    truth: Tensor
    """(P, 32, 128, 128) uint8, what is seen at the poses that are asked for."""
    again: Tensor
    """The same, with new speckle of the blood and new noise."""
    masks: Tensor
    """(P, 32, 128, 128) uint8 labels there."""
    asked: Tensor
    """(P, 32, 12) float32, the poses that are asked for, stratum after stratum."""
    distances: Tensor
    """(P, 32) float32 mm from there to the nearest frame of the scout."""


def scout(pool: Pool, seed: int, masks: bool = True) -> Scouted:
    """Scan all patients of a pool; each patient's part hangs on its own seed and on `seed` alone.

    Args:
        pool: of P still patients.
        seed: names the scouts.
        masks: whether masks and the truth drawn again are wanted; else both are empty.
    """
    plans = [plan(pool, row, seed) for row in range(len(pool))]
    swept, asked = (torch.stack(column) for column in zip(*plans, strict=True))
    images = _drawn(pool, swept, seed, 0)
    truth = _drawn(pool, asked, seed, 1)
    again = _drawn(pool, asked, seed, 2) if masks else truth[:, :0]
    rows = torch.arange(len(pool)).repeat_interleave(POSES)
    shown = truth[:, :0]
    if masks:
        shown = pool.mask(_pose(asked), rows).view(len(pool), POSES, *truth.shape[2:])
    away = torch.stack([nearest(*pair) for pair in zip(asked, swept, strict=True)]) * 1e3
    return Scouted(images, swept, truth, again, shown, asked, away)


def plan(pool: Pool, row: int, seed: int) -> tuple[Tensor, Tensor]:
    """Return the (64, 12) parameters of a patient's scout, and the (32, 12) that are asked for.

    Raises:
        RacinesError: a pool that beats.
    """
    if pool.beating:
        raise RacinesError("scouts are of still hearts: make the pool without beating")
    own = derive(sample_seeds(seed, 1), _STREAM, pool.seeds[row])
    swept = _sweep(pool, row, own)
    return swept, _asked(pool, row, swept, own)


def nearest(parameters: Tensor, among: Tensor) -> Tensor:
    """Return the (N,) distances, m, of (N, 12) parameters to the nearest of (M, 12) others."""
    first, second = (
        pose_keys(parameters_to_pose(each.double()), METRES_PER_RADIAN)
        for each in (parameters, among)
    )
    apart = torch.cdist(first, second, compute_mode="donot_use_mm_for_euclid_dist")
    return apart.amin(1).float()


def check_asked(patient: int, swept: Tensor, asked: Tensor) -> None:
    """Refuse (N, 12) poses that do not lie about the (M, 12) of a patient's scout.

    Raises:
        RacinesError: poses of another patient, with the one that lies farthest off.
    """
    away = nearest(asked, swept) * 1e3
    if float(away.max()) >= STRATA[-1]:
        row = int(away.argmax())
        raise RacinesError(
            f"patient {patient}: pose {row} lies {float(away[row]):.0f} mm from the nearest frame "
            f"of the scout, and {STRATA[-1]:g} is the most: these are poses of another patient"
        )


def strata_of(distances: Tensor) -> Tensor:
    """Return the stratum, from 0 on, of each of (…,) distances, mm."""
    inner = distances.new_tensor(STRATA[1:-1])
    return torch.bucketize(distances, inner, right=True)


def strata_names() -> tuple[str, ...]:
    """Return what the strata are called."""
    return tuple(f"{low:g}-{high:g} mm" for low, high in zip(STRATA, STRATA[1:], strict=False))


def _sweep(pool: Pool, row: int, seed: Tensor) -> Tensor:
    """Return the (64, 12) measured parameters of a patient's sweep."""
    draw = Draw(seed)
    targets = pool.targets(torch.tensor([row], device=pool.device)).to("cpu")
    views = coordinates(Pose(*(part[0] for part in targets)))
    order = draw.uniform(len(views)).argsort()
    points = torch.cat([around(views[view], PAST, draw, 2) for view in order.tolist()])
    points[:, 3:] = _unwrapped(points[:, 3:])
    shares = _apart(points) * (0.75 + 0.5 * draw.uniform(len(points) - 1))
    limits = limits_of(pool.workspace, SURFACE, PhantomConfig())
    hand = pool.seeds[row] % OPERATORS
    path = follow(points, shares, limits, SWEEPS, hand, FRAMES, draw)
    return record(pool, SWEEPS, path, seed).float()


def _unwrapped(angles: Tensor) -> Tensor:
    """Return (P, 3) angles, each at most half a turn from the one before: the short way round."""
    steps = torch.remainder(angles.diff(dim=0) + math.pi, 2.0 * math.pi) - math.pi
    return torch.cat([angles[:1], angles[:1] + steps.cumsum(0)])


def _apart(points: Tensor) -> Tensor:
    """Return the (P - 1,) distances, m, from each of (P, 6) way-points to the next."""
    turns = points.diff(dim=0)
    return torch.cat([turns[:, :3], turns[:, 3:] * METRES_PER_RADIAN], 1).norm(dim=1)


def _asked(pool: Pool, row: int, swept: Tensor, seed: Tensor) -> Tensor:
    """Return the (32, 12) parameters of poses in all strata, those of the nearest first."""
    share = POSES // (len(STRATA) - 1)
    return torch.cat(
        [_in_stratum(pool, row, swept, derive(seed, 2, each), each, share)
         for each in range(len(STRATA) - 1)]
    )  # fmt: skip


def _in_stratum(
    pool: Pool, row: int, swept: Tensor, seed: Tensor, stratum: int, wanted: int
) -> Tensor:
    """Return (wanted, 12) parameters so far from the sweep, at which the heart is seen."""
    found, low, high = [swept[:0]], STRATA[stratum], STRATA[stratum + 1]
    for turn in range(ROUNDS):
        tried = _strayed(swept, derive(seed, turn), low * 1e-3, high * 1e-3)
        parameters = pose_to_parameters(tried, pool.wrench(tried)).float()
        away = nearest(parameters, swept) * 1e3
        good = (away >= low) & (away < high) & _shows(pool, row, tried)
        found.append(parameters[good])
        if sum(map(len, found)) >= wanted:
            return torch.cat(found)[:wanted]
    raise RacinesError(
        f"patient {pool.seeds[row]}: fewer than {wanted} poses show the heart {low:g}-{high:g} mm "
        "from its scout: take another seed"
    )


def _strayed(swept: Tensor, seed: Tensor, low: float, high: float) -> Pose:
    """Return poses a distance between two, m, from frames of a sweep: shifts along the skin, turns.

    From frame to frame the nearest may be another one: who asks looks at what came out.
    """
    u = uniform(seed, CANDIDATES * 8, 1).view(CANDIDATES, 8).double()
    start = parameters_to_pose(swept.double())
    at = (u[:, 0] * len(swept)).long()
    away, mixture = low + (high - low) * u[:, 1], 0.5 * math.pi * u[:, 2]
    way, height = 2.0 * math.pi * u[:, 3], LIFT * (2.0 * u[:, 4] - 1.0)
    along = away * mixture.cos()
    shift = torch.stack([along * way.cos(), along * way.sin(), height], -1)
    chord = (away * mixture.sin() / METRES_PER_RADIAN / 2.0).clamp(max=1.0)
    axis = normalize(2.0 * u[:, 5:8] - 1.0, dim=-1)
    turn = axis_angle_to_matrix(axis * (2.0 * chord.asin()).unsqueeze(1))
    return Pose(start.position[at] + shift, orthonormalise(matmul3(start.rotation[at], turn)))


def _shows(pool: Pool, row: int, pose: Pose) -> Tensor:
    """Return (N,) whether a probe may be at poses and sees some of the heart there."""
    rows = torch.full((len(pose.position),), row)
    truth = pool.judge(pose, rows)
    seen = (truth.clarity >= CLEAR) & (truth.visibility.amax(1) >= SEEN)
    return seen & pool.workspace.contains(pose) & (-pool.wrench(pose)[:, 2] <= PRESSED)


def _drawn(pool: Pool, parameters: Tensor, seed: int, what: int) -> Tensor:
    """Return (P, N, 128, 128) images of (P, N, 12) parameters, with speckle of their own."""
    count = parameters.shape[1]
    rows = torch.arange(len(pool)).repeat_interleave(count)
    patients = torch.tensor(pool.seeds).repeat_interleave(count)
    each = torch.arange(count).repeat(len(pool))
    seeds = derive(torch.full_like(rows, seed), _STREAM, _SPECKLE, what, patients, each)
    images = pool.render(_pose(parameters), rows, seeds=seeds)
    return images.view(len(pool), count, *images.shape[1:])


def _pose(parameters: Tensor) -> Pose:
    return parameters_to_pose(parameters.flatten(0, 1).double())
