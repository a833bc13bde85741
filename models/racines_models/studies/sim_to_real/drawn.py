"""How near real frames are to what generators draw of patients whom they never saw.

    validation patient ──> scout ──> adapt ──> a view, from poses about the nominal one ──> KID
                  └──> the simulator's own frames from there ─────────────────────────────> KID

The generators learned from simulated patients alone, and nothing is chosen here. The simulator's
frames are what a generator is to draw: their distance to real ones is the world's, and what a
generator adds to it is its own. Hearts stand still at end diastole.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, pose_to_parameters
from racines_data.patients import Pool
from racines_data.randomness import derive
from racines_data.store.asked import AskedStore
from racines_models.adapting import adapted
from racines_models.sample import check_drawn, evenly
from racines_models.scores import metrics
from racines_models.scores.features import Extractor
from racines_models.statistics.intervals import interval
from racines_models.statistics.sets import set_replicates
from racines_models.studies.realism.poses import scattered

AT_ONCE = 16
"""Hearts in memory at once."""
FEWEST = 20
"""Frames below which there is no distance."""
SIMULATOR = "simulator"
"""The name of the simulator's own frames in the report."""


@dataclass(frozen=True)
class DrawnConfig:
    """Of whom generators draw what."""

    split: str = "validation"
    patients: int = 40
    poses: int = 4
    """Poses of each patient."""
    view: str = "A4C"
    grade: float = 5.0
    """Poses at which the view is graded below this are left out."""
    frames: int = 125
    """At most so many frames of each set."""
    seed: int = 0


class Wanted(NamedTuple):
    """What generators are shown of P patients, and N poses from which they draw."""

    patients: list[int]
    scouts: Tensor
    """(P, 64, 128, 128) uint8."""
    scout_parameters: Tensor
    """(P, 64, 12) float32."""
    row: Tensor
    """(N,) int64, the place of the patient."""
    parameters: Tensor
    """(N, 12) float32."""
    truth: Tensor
    """(N, 128, 128) uint8, what the simulator shows there."""


def wanted(
    config: DrawnConfig, cache: Path | None = None, progress: Callable[[int], None] | None = None
) -> Wanted:
    """Scan patients, or read their scouts in `cache`, and find poses that show the view.

    Raises:
        RacinesError: an unknown split or view, or more patients than the split has.
    """
    asked = AskedStore(config.split, config.patients, config.seed, cache, progress)
    patients = list(asked.patients or [])
    parts = [_of_hearts(patients[first : first + AT_ONCE], config)
             for first in range(0, len(patients), AT_ONCE)]  # fmt: skip
    row = torch.cat([AT_ONCE * number + rows for number, (rows, _, _) in enumerate(parts)])
    parameters, truth = (torch.cat(column) for column in list(zip(*parts, strict=True))[1:])
    some = evenly(len(row), config.frames)
    where = row[some], parameters[some], truth[some]
    return Wanted(patients, asked.scouts, asked.scout_parameters, *where)


def _of_hearts(patients: list[int], config: DrawnConfig) -> tuple[Tensor, Tensor, Tensor]:
    """Return places in the list, parameters, and what is seen, of poses that show the view."""
    pool = Pool(patients)
    if config.view not in pool.views:
        raise RacinesError(f"view {config.view}: choose one of {', '.join(pool.views)}")
    view = pool.views.index(config.view)
    targets = pool.targets(torch.arange(len(patients)))
    own = derive(torch.tensor(patients), config.seed)
    about = [
        scattered(Pose(*(x[place, view].expand(config.poses, *x.shape[2:]) for x in targets)), seed)
        for place, seed in enumerate(own.tolist())
    ]
    pose = Pose(*(torch.cat(parts) for parts in zip(*about, strict=True)))
    rows = torch.arange(len(patients)).repeat_interleave(config.poses)
    good = pool.judge(pose, rows).view_grade[:, view] >= config.grade
    pose, rows = Pose(*(part[good] for part in pose)), rows[good]
    each = torch.arange(config.poses).repeat(len(patients))[good]
    images = pool.render(pose, rows, seeds=derive(own[rows], each))
    return rows, pose_to_parameters(pose, pool.wrench(pose)).float(), images


def draw(generator: Any, wanted: Wanted, seed: int) -> Tensor:
    """Return the (N, 128, 128) images that a generator draws, adapted to each patient's scout.

    Raises:
        RacinesError: a scout that it cannot adapt to, or images that are none.
    """
    images = torch.zeros_like(wanted.truth)
    for place, patient in enumerate(wanted.patients):
        own = int(derive(torch.tensor(seed), patient))
        source = adapted(generator, wanted.scouts[place], wanted.scout_parameters[place], own)
        inside = (wanted.row == place).nonzero()[:, 0]
        if len(inside):
            seeds = derive(torch.tensor(own), torch.arange(len(inside)))
            images[inside] = source.generate(wanted.parameters[inside], seeds).cpu()
    return check_drawn(images)


def likeness(
    generators: Mapping[str, Sequence[Any]],
    wanted: Wanted,
    real: Mapping[str, Tensor],
    extractor: Extractor,
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
) -> dict[str, Any]:
    """Return KID to each set of real frames: of the simulator's frames, and of each generator's.

    Args:
        generators: the trainings of each, by name.
        wanted: what they draw, of whom.
        real: (M, 128, 128) uint8 frames by the name of their set.
        extractor: whose features are compared.
        seed: of all chance in adapting and drawing.
        progress: called with the number of images drawn.

    Raises:
        RacinesError: too few real frames or poses, or what a generator refuses.
    """
    count = check_enough(len(wanted.row), *(len(frames) for frames in real.values()))
    some = evenly(len(wanted.row), count)
    units = np.array(wanted.patients)[wanted.row[some].numpy()]
    beside = {name: extractor(frames[evenly(len(frames), count)]) for name, frames in real.items()}

    def told(drawings: list[Tensor]) -> dict[str, Any]:
        features = [extractor(images[some]) for images in drawings]
        return {name: _kid(features, frames, units) for name, frames in beside.items()}

    found = {SIMULATOR: told([wanted.truth])}
    for name, trainings in generators.items():
        drawings = []
        for each in trainings:
            drawings.append(draw(each, wanted, seed))
            if progress is not None:
                progress(len(wanted.row))
        found[name] = told(drawings)
    return {"kid": found, "n": count, "patients": len(np.unique(units))}


def check_enough(*counts: int) -> int:
    """Return the least of some numbers of frames, for which there is a distance.

    Raises:
        RacinesError: fewer than `FEWEST`.
    """
    if (least := min(counts)) < FEWEST:
        raise RacinesError(f"{least} frames: KID of what generators draw needs {FEWEST} or more")
    return least


def _kid(drawn: list[Tensor], real: Tensor, units: np.ndarray) -> dict[str, Any]:
    """Return KID with its interval over simulated patients and trainings; the real set is whole."""
    from torchmetrics.image.kid import poly_kernel

    def apart(one: Tensor, other: Tensor) -> Tensor:
        return poly_kernel(one.double(), other.double())

    pairs = len(real) * (len(real) - 1)
    own = apart(real, real).fill_diagonal_(0.0).sum() / pairs

    def of(features: Tensor) -> Callable[[np.ndarray], float]:
        within, between = apart(features, features).fill_diagonal_(0.0), apart(real, features)
        between = between.mean(0)

        def kid(keep: np.ndarray) -> float:
            kept = torch.from_numpy(keep).to(within)
            n = kept.sum()
            value = own + kept @ within @ kept / (n * (n - 1.0)) - 2.0 * (between @ kept) / n
            return float(value)

        return kid

    statistics = [of(each) for each in drawn]
    found = interval(set_replicates(statistics, units), kind="set")
    everything = np.ones(len(units), bool)
    by_training = [each(everything) for each in statistics]
    return found.to_json(**metrics.KID_SETTINGS, by_training=by_training)
