"""Three servos and the ensemble of them on validation patients: figures for docs/patient-tasks.md.

    python -m tests.envs.patients.ensembles A4C-patients PSAV-patients A4C-beating

Goes on where it was killed; a task that stands in the result file is not run again.
"""

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from racines_data.files import write_atomic
from racines_envs.agents.servo.agent import ServoAgent
from racines_envs.agents.servo.ensemble import EnsembleConfig, ServoEnsembleAgent
from racines_envs.evaluation.patients import (
    PatientsConfig,
    act_on_patients,
    patient_values,
    start_set,
)
from racines_envs.evaluation.trainings import find_trainings
from racines_envs.task.tasks import get_task
from racines_models.provenance import environment
from racines_models.statistics.intervals import Replicates, difference, interval, mean_replicates

ROOT = Path(__file__).parents[3]
RESULT, SERVO = ROOT / "docs/results/ensembles.json", ROOT / "envs/weights/servo"
PATIENTS, STARTS = 40, 2
SHOWN = "success_declared", "reached"
COLUMNS = [
    "view", "hearts", "one servo, of three", "the ensemble", "difference", "one passes through",
    "the ensemble does",
]  # fmt: skip


def percent(low: float | None, high: float | None) -> str:
    """Return an interval of shares."""
    return f"({100 * (low or 0.0):.0f} – {100 * (high or 0.0):.0f})"


def share(found: Replicates) -> str:
    """Return a share with its interval."""
    told = interval(found, 0.0, 1.0)
    return f"{100 * told.value:.0f} % {percent(told.low, told.high)}"


def of_task(task: str) -> list[str]:
    """Return the row of a task."""
    config = PatientsConfig(view=task, patients=PATIENTS, starts=STARTS)
    starts = start_set(config)
    with tempfile.TemporaryDirectory() as folder:
        made = ServoEnsembleAgent.train(EnsembleConfig(members=str(SERVO)), Path(folder))
    servos = [ServoAgent.load(each.folder) for each in find_trainings(SERVO)]
    acted = act_on_patients([*servos, made], config, starts)
    one, all_ = patient_values(acted[:-1]), patient_values(acted[-1:])
    each = {
        name: [mean_replicates(values[name], starts.units) for values in (one, all_)]
        for name in SHOWN
    }
    single, together = each["success_declared"]
    gain = difference(together, single)
    known = get_task(task)
    ahead = f"{100 * gain.value:+.0f} {percent(gain.low, gain.high)}"
    hearts = "still" if known.tier == "patients" else known.tier
    told, passes = ([share(of) for of in each[name]] for name in SHOWN)
    return [known.view, hearts, *told, ahead, *passes]


def main(tasks: list[str]) -> None:
    """Write the rows of tasks that are not there yet."""
    document: dict[str, Any] = {
        "schema": "racines.figures/1",
        "what": "three servos and the ensemble of them, on validation patients",
        "command": f"python -m tests.envs.patients.ensembles {' '.join(tasks)}",
        "machine": f"one core of a shared {environment('cpu')['cpu']}",
        "source": "measured once",
        "figures": {"patients": PATIENTS, "starts": STARTS},
        "tables": {"ensembles": {"columns": COLUMNS, "rows": []}},
    }
    if RESULT.is_file():
        document = json.loads(RESULT.read_text())
    rows = document["tables"]["ensembles"]["rows"]
    for task in tasks:
        known = get_task(task)
        hearts = "still" if known.tier == "patients" else known.tier
        if [known.view, hearts] not in [row[:2] for row in rows]:
            rows.append(of_task(task))
            write_atomic(RESULT, json.dumps(document, indent=2, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
