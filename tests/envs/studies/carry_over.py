"""What carries over: policies that learned on the one heart, on patients.

python -m tests.envs.studies.carry_over [AGENT …]

Each, all if none is named, acts from the starts of the boards of patients as on its own heart,
where nobody had to say that the view is found: so what it passes through stands beside what it
finds and declares. Trainings are those that are published. What was measured is kept in
`envs/runs/carry-over`, and the table is of all that is kept there.
"""

import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from racines_data.files import write_json
from racines_envs.agents import load_agent
from racines_envs.evaluation.measures import measure_patients, patient_values
from racines_envs.evaluation.patients import PatientsConfig, act_on_patients, start_set
from racines_envs.evaluation.trainings import find_trainings

ROOT = Path(__file__).parents[3]
RESULT = ROOT / "docs/results/carry-over.json"
KEPT = Path("envs/runs/carry-over")
BOARDS = ROOT / "leaderboard/results"
VIEWS = {"SC": "", "A4C": "-a4c", "PL": "-pl", "PSAV": "-psav", "PSMV": "-psmv"}
AGENTS = {
    **{f"ppo-image{suffix}": view for view, suffix in VIEWS.items()},
    "behaviour-cloning-image": "SC",
    "ppo-multimodal": "SC",
    "ppo": "SC",
    "dqn": "SC",
}
"""Published policies, and the view that each was trained for."""
TIERS = {"patients": "still", "beating": "beating"}
SHARES = ("success_declared", "reached", "declared")
CONFIG = PatientsConfig(split="test", patients=140, starts=3)
"""As the boards of patients have it."""


def act(name: str, tier: str) -> dict[str, Any]:
    """Return what an agent's trainings do on patients."""
    began, folder = time.perf_counter(), ROOT / "envs/weights" / name
    kind = json.loads((folder / "config.json").read_text())["agent"]
    trainings = find_trainings(folder)
    agents = [load_agent(kind, each.folder) for each in trainings]
    config = replace(CONFIG, view=f"{AGENTS[name]}-{tier}")
    starts = start_set(config)
    values = patient_values(act_on_patients(agents, config, starts))
    metrics, _ = measure_patients(values, starts.units)
    shares = {key: metrics[key] for key in SHARES}
    seconds = round(time.perf_counter() - began, 1)
    return {"sees": agents[0].observation, "trainings": len(agents), "seconds": seconds, **shares}


def place(name: str, tier: str) -> Path:
    """Return where the figures of an agent are kept."""
    return KEPT / f"{name}-{tier}.json"


def percent(told: dict[str, Any]) -> str:
    """Return a share and its interval."""
    value, low, high = (f"{100 * told[key]:.0f}" for key in ("value", "low", "high"))
    return f"{value} % ({low} – {high})"


def figures() -> dict[str, Any]:
    """Return the table of what is kept: a row an agent, its own heart beside patients."""
    rows, names, seconds, whole = [], [], 0.0, {}
    for name, view in AGENTS.items():
        if not all(place(name, tier).is_file() for tier in TIERS):
            continue
        record = json.loads((BOARDS / f"phantom-reference/agents/{name}.json").read_text())
        own, cells = record["scores"]["metrics"]["success_true"], []
        for tier in TIERS:
            told = json.loads(place(name, tier).read_text())
            cells += [percent(told["success_declared"]), percent(told["reached"])]
            seconds += told["seconds"]
            for key in ("success_declared", "reached"):
                value = 100 * told[key]["value"]
                whole[key] = round(max(value, whole.get(key, 0.0)), 1)
        sees = {"params": "pose", "multimodal": "both"}.get(told["sees"], told["sees"])
        names.append(name)
        rows.append([f"`{name}`", view, sees, str(told["trainings"]), percent(own), *cells])
    columns = ["agent", "view", "sees", "trainings", "its own heart, found"]
    for title in TIERS.values():
        columns += [f"{title}: found and declared", f"{title}: passed through"]
    return {
        "schema": "racines.figures/1",
        "what": "published policies of the one heart on test patients; shares: the highest of all",
        "machine": "one core of an AMD EPYC",
        "source": "measured once",
        "command": f"python -m tests.envs.studies.carry_over {' '.join(names)}",
        "figures": {"minutes": round(seconds / 60), "patients": CONFIG.patients, **whole},
        "tables": {"agents": {"columns": columns, "rows": rows}},
    }


if __name__ == "__main__":
    for name in sys.argv[1:] or AGENTS:
        for tier in TIERS:
            if not place(name, tier).is_file():
                write_json(place(name, tier), act(name, tier))
                print(place(name, tier), flush=True)
    write_json(RESULT, figures())
