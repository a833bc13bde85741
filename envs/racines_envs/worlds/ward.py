"""Patients as a world: every row of an environment scans one of a pool's, at its own moment.

    a ward is a pool; its cases are the patients, by their place in the pool
    a scene is rows, each of one patient at one phase of beat and breath

What is seen is the moment. What is true of a pose on a beating heart is what a clip shows that an
examiner records there, the breath held after breathing out: the median over a beat. A single moment
would make chance of it, as a short axis passes in and out of the plane with every beat, and 15 mm
of breath bring a rib before any window.
"""

from collections.abc import Sequence
from functools import lru_cache, partial

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose
from racines_data.own.pool import make_pool
from racines_data.patients.memory import MEMORY, PoolTooLarge
from racines_data.patients.pool import Pool
from racines_data.patients.splits import check_split, seeds_of
from racines_data.phantom.model import VECTORS
from racines_data.randomness import uniform
from racines_data.views import LABELS, VIEWS
from racines_data.world import Truth, World
from racines_envs.task.names import BEATING, HEART_TIER

BEAT = (0.0, 0.2, 0.4, 0.6, 0.8)
"""Cardiac phases of the clip that is judged."""
PATIENTS = 8
"""Patients that an environment draws its episodes from, where it is not said how many."""
_WHO = 63  # random stream of an episode


class Ward(World):
    """The patients of a pool; an episode's seed names one of them."""

    views, labels = VIEWS, LABELS

    def __init__(self, pool: Pool) -> None:
        """Take a pool; its hearts beat where it is a beating one."""
        self.pool, self.workspace = pool, pool.workspace

    @property
    def surface_height(self) -> float:
        """Height of the skin, m."""
        return self.pool.surface_height

    def cases(self, seeds: Tensor) -> Tensor:
        """Return (N,) places in the pool, each patient as likely."""
        return (uniform(seeds, 1, _WHO)[:, 0] * len(self.pool)).long()

    def case_of(self, patients: Sequence[int]) -> Tensor:
        """Return the (N,) places in the pool of N patients, by their seeds.

        Raises:
            RacinesError: a patient who is not in the pool.
        """
        place = {seed: row for row, seed in enumerate(self.pool.seeds)}
        for patient in patients:
            if patient not in place:
                held = ", ".join(map(str, self.pool.seeds[:8]))
                raise RacinesError(f"patient {patient} is not in the pool, which holds {held}, …")
        rows = [place[patient] for patient in patients]
        return torch.tensor(rows, dtype=torch.int64, device=self.pool.device)

    def scene(self, case: Tensor, time: Tensor) -> "Scene":
        """Return (B,) patients, at (B,) seconds where their hearts beat."""
        phase = self.pool.phase(case, time) if self.pool.beating else None
        return Scene(self.pool, case, phase)

    def wrench(self, pose: Pose, velocity: Tensor | None = None) -> Tensor:
        """Return (B, 6) force and torque: the skin is everyone's."""
        return self.pool.wrench(pose, velocity)

    def target(self, view: str) -> Pose:
        """Refuse: each patient has poses of its own."""
        raise RacinesError("patients have nominal poses of their own: ask a scene of the ward")

    def judge(self, pose: Pose) -> Truth:
        """Refuse: whose heart is not said."""
        raise RacinesError("a ward has many hearts: ask a scene of it")

    def render(self, pose: Pose, seeds: Tensor) -> Tensor:
        """Refuse: whose heart is not said."""
        raise RacinesError("a ward has many hearts: ask a scene of it")


class Scene(World):
    """B rows, each of a patient at a phase."""

    views, labels = VIEWS, LABELS

    def __init__(self, pool: Pool, case: Tensor, phase: Tensor | None) -> None:
        """Take a pool, (B,) places in it, and (B, 2) phases; None: still, as at end diastole."""
        self._pool, self._case, self._phase = pool, case, phase
        self.workspace = pool.workspace

    @property
    def surface_height(self) -> float:
        """Height of the skin, m."""
        return self._pool.surface_height

    def at(self, rows: Tensor) -> "Scene":
        """Return the scene of (M,) of the rows."""
        phase = None if self._phase is None else self._phase[rows]
        return Scene(self._pool, self._case[rows], phase)

    def target(self, view: str) -> Pose:
        """Return the (B,) nominal poses of a view."""
        return self.nominal(torch.full_like(self._case, VIEWS.index(view)))

    def nominal(self, labels: Tensor) -> Pose:
        """Return the (B,) nominal poses for (B,) labels, breathed out."""
        each = torch.arange(len(labels), device=labels.device)
        return Pose(*(part[each, labels] for part in self._pool.targets(self._case)))

    def judge(self, pose: Pose) -> Truth:
        """Return the truth of (B,) poses, one a row: of the still heart, or over a beat."""
        if self._phase is None:
            return self._pool.judge(pose, self._case)
        return over_beat(self._pool.judge_beat(pose, self._case, BEAT))

    def judge_alike(self, pose: Pose) -> Truth:
        """Return the same, each as if it were alone: the rows are filled up to whole vectors."""
        count = len(pose.position)
        rows = torch.arange(count + -count % VECTORS, device=self._case.device).remainder(count)
        truth = self.at(rows).judge(Pose(*(part[rows] for part in pose)))
        return Truth(*(column[:count] for column in truth))

    def wrench(self, pose: Pose, velocity: Tensor | None = None) -> Tensor:
        """Return (B, 6) force and torque."""
        return self._pool.wrench(pose, velocity)

    def render(self, pose: Pose, seeds: Tensor) -> Tensor:
        """Return (B, 128, 128) uint8 images of poses, one a row."""
        return self._pool.render(pose, self._case, self._phase, seeds)


def over_beat(moments: Truth) -> Truth:
    """Return what is true of a clip: the medians over its moments, and the view that they attain.

    All of `moments` is (M, B, …). The grade is that of the view, 1 or more, as the oracle's of a
    moment is.
    """
    *_, membership, grades, clarity, visibility = (column.median(0).values for column in moments)
    best, view = membership.max(-1)
    attained = best > 0.5
    own = grades.gather(-1, view.unsqueeze(-1)).squeeze(-1).clamp_min(1.0)
    grade = torch.where(attained, own, 0.0)
    view = torch.where(attained, view, len(VIEWS))
    return Truth(view, grade, membership, grades, clarity, visibility)


def make_ward(
    tier: str,
    split: str = "train",
    patients: int | Sequence[int] | None = None,
    device: torch.device | str = "cpu",
    memory: int | None = MEMORY,
    phantom: str = "",
) -> Ward:
    """Return a ward of patients, which is made once.

    Args:
        tier: `patients` or `beating`.
        split: `train`, `validation` or `test`.
        patients: So many of the split, its first, or their seeds; `PATIENTS` by default.
        device: Where their voxels lie.
        memory: Bytes that the voxels may take; None: nobody looks at them.
        phantom: Folder or name of a heart of one's own that all of them have in place of theirs.

    Raises:
        RacinesError: an unknown split, a seed of another, more patients than it has or than fit; a
            phantom that is not there or no heart.
    """
    if tier == HEART_TIER:
        raise RacinesError("the one heart has no patients: use tier 'patients' or 'beating'")
    seeds = choose_patients(split, PATIENTS if patients is None else patients)
    pool = partial(_pool, seeds, str(device), tier == BEATING, memory, phantom)
    try:
        return Ward(pool())
    except PoolTooLarge:
        _pool.cache_clear()  # what is kept for whoever comes again gives way
        return Ward(pool())


def choose_patients(split: str, patients: int | Sequence[int]) -> tuple[int, ...]:
    """Return the seeds of the first so many patients of a split, or of those given.

    Raises:
        RacinesError: an unknown split, a seed of another, or more than the split has.
    """
    if isinstance(patients, int):
        known = seeds_of(split)
        if not 0 < patients <= len(known):
            raise RacinesError(f"{patients} patients: split {split!r} has 1 to {len(known)}")
        return tuple(known[:patients])
    check_split(list(patients), split)
    return tuple(patients)


@lru_cache(maxsize=2)
def _pool(
    seeds: tuple[int, ...], device: str, beating: bool, memory: int | None, phantom: str
) -> Pool:
    return make_pool(seeds, device, beating, memory, phantom)
