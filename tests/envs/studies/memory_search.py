"""What a memory gains from two settings and twice as many patients to learn from.

    python -m tests.envs.studies.memory_search

`servo-memory-full`, and `servo-memory-plus`, which keeps readings where views can lie, looks about
more often and was taught by twice as many patients; and each with the other's settings, so that
what these do and what the patients do is told apart: from the same starts on validation patients on
whom nothing was chosen. What was measured is kept in `envs/runs/memory-search`: a study that was
killed goes on.
"""

import json
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

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
KEPT = Path("envs/runs/memory-search")


class Way(NamedTuple):
    """Who is judged, by which settings."""

    agent: str
    settings: Mapping[str, Any]


FEW, MORE = {"bounded": False, "looks": 0}, {"bounded": True, "looks": 2}
WAYS = {
    "`servo-memory-full`": Way("servo-memory-full", FEW),
    "`servo-memory-plus`": Way("servo-memory-plus", MORE),
    "the first, with both settings": Way("servo-memory-full", MORE),
    "the second, without them": Way("servo-memory-plus", FEW),
}
VIEWS = ("A4C", "PL")
JUDGED = PatientsConfig(split="validation", patients=40, starts=3)
STARTS = StartSet(tuple(seeds_of("validation")[700 : 700 + JUDGED.patients]), JUDGED.starts, 0)
SHARES = {"success_declared": "found and declared", "reached": "passed through"}


def point(way: Way, view: str, starts: StartSet = STARTS) -> dict[str, Any]:
    """Return what all trainings of a way find."""
    trainings = find_trainings(ROOT / "envs/weights" / way.agent)
    hashes = [each.files for each in trainings]
    about = {"starts": starts._asdict(), "view": view, "trainings": hashes, **way.settings}
    path = KEPT / f"{recipe_digest(about)[:12]}.json"
    if not path.is_file():
        began = time.perf_counter()
        agents = [ServoMemoryAgent.load(each.folder) for each in trainings]
        for each in agents:
            each.config = replace(each.config, **way.settings)
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
        "what": "a memory with two further settings, and taught by more, still validation patients",
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
    judged = {told: {view: point(way, view) for view in VIEWS} for told, way in WAYS.items()}
    write_json(RESULT, figures(judged))
