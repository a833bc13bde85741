"""What two settings of a memory are worth: readings kept where views can lie, and more looks.

    python -m tests.envs.studies.memory_search

The three published trainings of `servo-memory-full`, with each setting and with both, from the same
starts on validation patients on whom nothing was chosen. What was measured is kept in
`envs/runs/memory-search`: a study that was killed goes on.
"""

import json
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from racines_data.digest import recipe_digest
from racines_data.files import write_json
from racines_data.patients.splits import seeds_of
from racines_envs.agents.memory.agent import ServoMemoryAgent
from racines_envs.evaluation.measures import measure_patients, patient_values
from racines_envs.evaluation.patients import PatientsConfig, StartSet, act_on_patients
from racines_envs.evaluation.trainings import find_trainings
from racines_models.provenance import environment
from tests.envs.studies.patients_curve import percent

ROOT = Path(__file__).parents[3]
RESULT = ROOT / "docs/results/memory-search.json"
AGENT, KEPT = ROOT / "envs/weights/servo-memory-full", Path("envs/runs/memory-search")
WAYS: dict[str, Mapping[str, Any]] = {
    "as it was": {"bounded": False, "looks": 0},
    "`bounded`": {"bounded": True, "looks": 0},
    "`looks: 2`": {"bounded": False, "looks": 2},
    "both": {"bounded": True, "looks": 2},
}
VIEWS = ("A4C", "PL")
JUDGED = PatientsConfig(split="validation", patients=40, starts=3)
STARTS = StartSet(tuple(seeds_of("validation")[600 : 600 + JUDGED.patients]), JUDGED.starts, 0)
SHARES = {"success_declared": "found and declared", "reached": "passed through"}


def point(way: str, view: str, starts: StartSet = STARTS) -> dict[str, Any]:
    """Return what all trainings find with a way's settings."""
    trainings = find_trainings(AGENT)
    hashes = [each.files for each in trainings]
    about = {"starts": starts._asdict(), "view": view, "trainings": hashes, **WAYS[way]}
    path = KEPT / f"{recipe_digest(about)[:12]}.json"
    if not path.is_file():
        began = time.perf_counter()
        agents = [ServoMemoryAgent.load(each.folder) for each in trainings]
        for each in agents:
            each.config = replace(each.config, **WAYS[way])
        acted = act_on_patients(agents, replace(JUDGED, view=f"{view}-patients"), starts)
        metrics, _ = measure_patients(patient_values(acted), starts.units)
        told = {"steps": metrics["episode_steps"]["value"], "trainings": len(agents)}
        told |= {key: metrics[key] for key in SHARES}
        write_json(path, told | {"seconds": round(time.perf_counter() - began, 1)})
        print(way, view, path.read_text(encoding="utf-8"), flush=True)
    return json.loads(path.read_text(encoding="utf-8"))


def figures(points: Mapping[str, Mapping[str, dict[str, Any]]]) -> dict[str, Any]:
    """Return the table of the points of each way by view."""
    rows, every = [], [each for views in points.values() for each in views.values()]
    for way, views in points.items():
        cells = [percent(each[key]) for each in views.values() for key in SHARES]
        rows.append([way, *cells, f"{max(each['steps'] for each in views.values()):.0f}"])
    levels = [each[key]["settings"]["level"] for each in every for key in SHARES]
    columns = ["", *(f"{view}: {told}" for view in VIEWS for told in SHARES.values()), "steps"]
    return {
        "schema": "racines.figures/1",
        "what": "servo-memory-full with two further settings, still validation patients",
        "command": "python -m tests.envs.studies.memory_search",
        "machine": f"one core of a shared {environment('cpu')['cpu']}",
        "source": "measured once",
        "figures": {
            "patients": JUDGED.patients, "starts": JUDGED.starts,
            "trainings": every[0]["trainings"], "level": round(100 * min(levels)),
            "minutes": round(sum(each["seconds"] for each in every) / 60),
        },
        "tables": {"search": {"columns": columns, "rows": rows}},
    }  # fmt: skip


if __name__ == "__main__":
    write_json(RESULT, figures({way: {view: point(way, view) for view in VIEWS} for way in WAYS}))
