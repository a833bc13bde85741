"""Frames of simulated patients, to be held beside real ones: many patients, one frame each.

train patients in order ──> near the nominal pose of the view ──> graded well enough ──> drawn
"""

from typing import Any

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose
from racines_data.patients import PATIENTS_VERSION, Pool, seeds_of
from racines_data.randomness import derive, uniform
from racines_models.studies.realism.poses import scattered
from racines_models.studies.realism.report import RealismConfig, Simulated

SPLIT = "train"
AT_ONCE = 16
"""Hearts in memory at once."""
CONFIGS = {"patients": False, "beating": True}
"""Names of the worlds, as those of a dataset's configs, and whether hearts beat in them."""


def of_patients(config: RealismConfig, beating: bool) -> Simulated:
    """Draw `config.frames` frames of the first train patients, one each.

    Still hearts stand at end diastole, the others at any moment of beat and breath. A patient
    whose frame is graded below `config.grade` is passed over, as such a frame of a dataset is.

    Raises:
        RacinesError: the patients have no such view.
    """
    seeds, found, patients, looked = seeds_of(SPLIT), [], [], 0
    while len(patients) < config.frames and looked < len(seeds):
        part = seeds[looked : looked + min(AT_ONCE, 2 * (config.frames - len(patients)))]
        images, good = _draw(part, config, beating)
        found.append(images[good])
        patients += [seed for seed, kept in zip(part, good.tolist(), strict=True) if kept]
        looked += len(part)
    images, patients = torch.cat(found)[: config.frames], patients[: config.frames]
    world: dict[str, Any] = {
        "version": PATIENTS_VERSION,
        "split": SPLIT,
        "patients": [patients[0], patients[-1]],
        "passed_over": patients[-1] - seeds[0] + 1 - len(patients),
    }
    name = "beating" if beating else "patients"
    return Simulated(images, {"config": name, "world": world, "phantom_hearts": len(patients)})


def _draw(seeds: range, config: RealismConfig, beating: bool) -> tuple[Tensor, Tensor]:
    """Return the (N, 128, 128) frames of N patients, and (N,) which are graded well enough."""
    pool, rows = Pool(seeds, beating=beating), torch.arange(len(seeds))
    if config.view not in pool.views:
        raise RacinesError(f"realism.view {config.view}: choose one of {', '.join(pool.views)}")
    view = pool.views.index(config.view)
    # What a patient is drawn with hangs on no neighbour in the pool.
    own = derive(torch.tensor(list(seeds)), config.seed)
    phase = uniform(own, 2, 73).double() if beating else None
    targets = pool.targets(rows, phase)
    near = [scattered(Pose(*(x[i : i + 1, view] for x in targets)), seed)
            for i, seed in enumerate(own.tolist())]  # fmt: skip
    pose = Pose(*(torch.cat(parts) for parts in zip(*near, strict=True)))
    good = pool.judge(pose, rows, phase).view_grade[:, view] >= config.grade
    return pool.render(pose, rows, phase, own), good
