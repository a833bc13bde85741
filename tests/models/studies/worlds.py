"""What leaflets and the chest wall of the simulated world are worth to a grader, on real frames.

python -m tests.models.studies.worlds DATA REAL FOLDER [SEEDS]

Draws the training frames of the config `beating` of DATA anew, at their recorded poses and moments:
as the world is, without leaflets of valves, and without what ribs, lung and uneven tissue do to
beams. Labels stay those of the world. Trains a small grader on each, with the augmentation of the
published one, and asks it about simulated validation patients, whose world is whole, and about
REAL's frames of the tuning list. What is in FOLDER is kept; nothing here chooses a judge.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from racines_data.files import write_json
from racines_data.geometry import parameters_to_pose
from racines_data.patients.heart import Heart
from racines_data.patients.labels import MITRAL
from racines_data.patients.patient import Patient
from racines_data.patients.pool import Pool
from racines_data.patients.population import draw_patient
from racines_data.progress import progress_bar
from racines_data.randomness import derive
from racines_data.store.frames import FrameStore, open_store
from tests.models.studies.augmentation import RESULT, USED, answers, real_echo, table

WORLDS = {"as it is": "", "without leaflets": "leaflets", "without chest wall": "chest"}
"""By what the table calls it: what the world lacks."""
OUT = RESULT.with_name("augmentation-worlds.json")
STREAM = 0x3041


def without_chest(patient: Patient) -> Patient:
    """Return a patient whose ribs, lung and uneven tissue take nothing from a beam."""
    return replace(patient, chest=replace(patient.chest, cover=0.0, rib_loss=0.0, lung_loss=0.0))


class LackingPool(Pool):
    """Patients in a world that lacks something."""

    def __init__(self, patients: Sequence[Patient], lacks: str) -> None:
        """Lay patients into a world without `leaflets` or `chest`; without nothing if empty."""
        self._lacks = lacks
        lying = [without_chest(each) if lacks == "chest" else each for each in patients]
        super().__init__(lying, beating=True)

    def _join(self, hearts: list[Heart]) -> None:
        super()._join(hearts)
        if self._lacks == "leaflets":  # what is no solid anywhere is blood
            self._solid[:, MITRAL:] = 0.0


def drawn_in(store: FrameStore, split: str, lacks: str) -> Tensor:
    """Return the store's images, those of a split as a world without something shows them."""
    assert store.patients is not None and store.phases is not None
    images = store.images.clone()
    rows = store.split_indices(split)
    patients = torch.tensor(store.patients)[store.trajectory_index[rows]]
    with progress_bar(True) as bar:
        for seed in bar.track(patients.unique().tolist(), description=f"without {lacks or '-'}"):
            own = rows[patients == seed]
            pool = LackingPool([draw_patient(int(seed))], lacks)
            pose = parameters_to_pose(store.parameters[own].double())
            seeds = derive(torch.full_like(own, STREAM), own)
            images[own] = pool.render(pose, torch.zeros_like(own), store.phases[own], seeds)
    return images


def with_images(store: FrameStore, images: Tensor) -> FrameStore:
    """Return a store of the same frames with other images, for this process."""
    other = object.__new__(FrameStore)
    words = images.view(len(images), -1).view(torch.int64)
    vars(other).update(vars(store), images=images, _words=words, _as_recorded=False)
    return other


def run(data: Path, real: Path, folder: Path, seeds: int) -> None:
    """Draw, train, ask, and write the table."""
    store, echo = open_store(data, "beating"), real_echo(real)
    told = {}
    for name, lacks in WORLDS.items():
        places = [folder / f"{lacks or 'whole'}-{seed}" for seed in range(seeds)]
        there = all((place / "asked.json").is_file() for place in places)
        shown = store if there else with_images(store, drawn_in(store, "train", lacks))
        told[name] = [answers(place, USED, seed, shown, store, echo)
                      for seed, place in enumerate(places)]  # fmt: skip
    write_json(OUT, {
        "schema": "racines.figures/1",
        "what": "graders of patients by what the world of their training frames lacks: simulated "
        "validation patients, and the share of real frames (tuning list) called A4C, per cent",
        "command": "python -m tests.models.studies.worlds DATA REAL FOLDER 3",
        "machine": "one core of an AMD EPYC (Zen 4)",
        "source": "measured once",
        "figures": {"trainings": seeds},
        "tables": {"worlds": table("world of the training frames", told)},
    })  # fmt: skip


if __name__ == "__main__":
    torch.set_num_threads(1)
    where = [Path(each) for each in sys.argv[1:4]]
    run(*where, int(sys.argv[4]) if len(sys.argv) > 4 else 1)
