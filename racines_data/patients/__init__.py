"""Patients: simulated hearts that nobody trained on, which beat and breathe.

    draw_patient(seed) -> Patient       who a seed is; `dataclasses.asdict` is JSON
    lie_anew(patient, other) -> Patient lying and examined as another; its baked voxels stay
    split_of(seed), seeds_of(split)     whose a seed is; SPLITS, and secret seeds from 1,000,000 up
    Pool(seeds, device, beating, memory)
        .render(pose, rows, phase, seeds) -> (B, 128, 128) uint8 images
        .mask(pose, rows, phase)          -> (B, 128, 128) uint8, numbers of LABELS
        .judge(pose, rows, phase)         -> Truth, of the moved heart
        .targets(rows, phase)             -> Pose of (B, V): nominal poses
        .phase(rows, time, hold_breath)   -> (B, 2) cardiac and respiratory phase in [0, 1)
        .wrench(pose, velocity), .workspace, .measures(row)

A row is one probe on one of the pool's patients: `rows` says which. Phases are never observed;
where none is given, hearts stand at end diastole, breathed out. `CAMUS` maps LABELS to CAMUS's.

    patient, population, splits     who: sizes given body and sex, pathologies, place, chest, beat
    form, landmarks, paint, valves  where things are in a heart, and what each point of it is
    labels, tiles, volume, bake     how they scatter, and the voxels that they become
    motion, rhythm, chest           beat, breath, tissue that gives, ribs and lung
    placement, settings, sampling   from a probe's pose to voxels, in exact arithmetic
    render, oracle, nominal         pictures, truth, and the poses that show a view best
    heart, pool, measures           one patient made ready, many in one tensor, true volumes
"""

from racines_data.patients.labels import CAMUS, LABELS
from racines_data.patients.patient import PATHOLOGIES, PATIENTS_VERSION, Patient
from racines_data.patients.pool import Pool
from racines_data.patients.population import draw_patient, lie_anew
from racines_data.patients.splits import SPLITS, check_split, seeds_of, split_of

__all__ = [
    "CAMUS",
    "LABELS",
    "PATHOLOGIES",
    "PATIENTS_VERSION",
    "SPLITS",
    "Patient",
    "Pool",
    "check_split",
    "draw_patient",
    "lie_anew",
    "seeds_of",
    "split_of",
]
