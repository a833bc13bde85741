"""What each part of the strong augmentation is worth to a grader of patients, on real frames.

python -m tests.models.studies.augmentation DATA REAL FOLDER [SEEDS]

Trains small graders on the config `beating` of DATA, one with no part, one with all but shadows,
one with all, and one without each part in turn; asks each about REAL's frames. Validation patients
and the tuning list alone: what is reported of the published judges is not looked at. A training
that is in FOLDER is kept, and one that was stopped goes on. Nothing here chooses a judge.
"""

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from racines_data.config import fill
from racines_data.errors import RacinesError
from racines_data.files import write_json
from racines_data.store.frames import FrameStore, open_store
from racines_models.judges.grader.model import WEIGHTS, Grader, GraderConfig
from racines_models.judges.grader.report import examine
from racines_models.judges.grader.training import train_grader
from racines_models.protocol import Run
from racines_models.studies.sim_to_real.frames import RealEcho, read_real_echo
from racines_models.studies.sim_to_real.report import measure
from racines_models.training.augmentation import PARTS

RESULT = Path(__file__).parents[3] / "docs/results/augmentation.json"
USED = tuple(name for name in PARTS if name != "shadow")
"""What the published grader of patients has."""
VARIANTS = {
    "none": (),
    "all but shadow": USED,
    "… and shadow": PARTS,
    **{f"… without {out}": tuple(each for each in USED if each != out) for out in USED},
}
SETTINGS: dict[str, Any] = {
    "input_size": 64,
    "width": 0.375,
    "view_stage": {"epochs": 1},
    "grade_stage": {"epochs": 1},
}
SHARES = {
    "A4C": "as they are",
    "upside down": "upside down",
    "scrambled": "scrambled",
    "mirrored": "mirrored",
}


def taught(parts: Sequence[str], store: FrameStore, folder: Path, seed: int) -> Grader:
    """Return a grader that learned with those parts, from the folder if it is there."""
    if not ((folder / WEIGHTS).is_file() and (folder / "metrics.json").is_file()):
        config = fill(GraderConfig, SETTINGS | {"strong": {"parts": parts}}, "grader")
        train_grader(store, config, Run(folder, seed, "cpu", None))
    return Grader.load(folder)


def asked(grader: Grader, store: FrameStore, echo: RealEcho) -> dict[str, float]:
    """Return what it says of simulated validation patients and of real frames, in per cent."""
    report = examine(grader, store, "validation").content
    simulated = report["metrics"]
    real = measure(echo, grader).content
    told = {
        "balanced accuracy": 100 * simulated["balanced_accuracy"]["value"],
        "grade MAE": simulated["grade_mae"]["value"],
        "ECE": 100 * report["calibration"]["after"]["value"],
    }
    for name, control in SHARES.items():
        told[name] = 100 * real["acceptance"]["tuning"][control]["called_a4c"]["value"]
    told["A4C, p ≥ 0.9"] = 100 * real["acceptance"]["tuning"]["as they are"]["surely_a4c"]["value"]
    sectors = real["rotation"]["sectors"]
    return told | {"turned 45°–135°": 100 * sectors["between"]["called_a4c"]}


def answers(
    place: Path,
    parts: Sequence[str],
    seed: int,
    shown: FrameStore,
    store: FrameStore,
    echo: RealEcho,
) -> dict[str, float]:
    """Return what a grader says that learned from the frames shown; from its folder if there."""
    if not (place / "asked.json").is_file():
        told = asked(taught(parts, shown, place, seed), store, echo)
        write_json(place / "asked.json", told)
    return json.loads((place / "asked.json").read_text())


def cell(values: Sequence[float]) -> str:
    """Return the mean over trainings, with the range where there are several."""
    mean = f"{sum(values) / len(values):.1f}"
    return mean if len(values) == 1 else f"{mean} ({min(values):.1f} – {max(values):.1f})"


def table(first: str, told: Mapping[str, Sequence[dict[str, float]]]) -> dict[str, Any]:
    """Return the table of what graders said, a row a kind of training; `first` names the kinds."""
    columns = list(next(iter(told.values()))[0])
    rows = [[name, *(cell([each[key] for each in own]) for key in columns)]
            for name, own in told.items()]  # fmt: skip
    return {"columns": [first, *columns], "rows": rows}


def real_echo(real: Path) -> RealEcho:
    """Read REAL: frames of the tuning list, and a heart turned about its apex."""
    echo = read_real_echo(real, None)
    if echo.rotation is None:
        raise RacinesError(f"{real}: no rotation: give the folder of frames and rotation")
    return echo


def run(data: Path, real: Path, folder: Path, seeds: int) -> None:
    """Train, ask, and write the table."""
    store, echo = open_store(data, "beating"), real_echo(real)
    told: dict[str, list[dict[str, float]]] = {name: [] for name in VARIANTS}
    for seed in range(seeds):
        for name, parts in VARIANTS.items():
            place = folder / f"{'-'.join(sorted(parts)) or 'none'}-{seed}"
            told[name].append(answers(place, parts, seed, store, store, echo))
    images = 2 * len(store.split_indices("train"))
    write_json(RESULT, {
        "schema": "racines.figures/1",
        "what": "graders of patients by their strong augmentation: simulated validation patients, "
        "and the share of real frames (tuning list) called A4C, per cent",
        "command": "python -m tests.models.studies.augmentation DATA REAL FOLDER",
        "machine": "one core of an AMD EPYC (Zen 4)",
        "source": "measured once",
        "figures": {"trainings": seeds, "images": images, "frames": len(echo.frames.images) // 2},
        "tables": {"parts": table("parts", told)},
    })  # fmt: skip


if __name__ == "__main__":
    torch.set_num_threads(1)
    where = [Path(each) for each in sys.argv[1:4]]
    run(*where, int(sys.argv[4]) if len(sys.argv) > 4 else 1)
