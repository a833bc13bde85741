"""What carries over: policies that learned on the one heart, on patients.

python -m tests.envs.studies.carry_over [AGENT …]

Each, all if none is named, acts from the starts of the boards of patients as on its own heart,
where nobody had to say that the view is found: so what it passes through stands beside what it
finds and declares. Trainings are those that are published. What was measured is kept in
`envs/runs/carry-over`; the table is of all that is kept there, and of what it told before.
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
    "behaviour-cloning": "SC",
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


def figures(before: dict[str, Any]) -> dict[str, Any]:
    """Return the table: a row an agent, its own heart beside patients.

    Of what is not kept, a row stays as it was told before; so does its part of the figures.
    """
    told_before = {row[0]: row for row in before["tables"]["agents"]["rows"]}
    rows, names = [], []
    whole = {key: before["figures"][key] for key in (*SHARES[:2], "minutes")}
    for name, view in AGENTS.items():
        if not all(place(name, tier).is_file() for tier in TIERS):
            if (row := told_before.get(f"`{name}`")) is not None:
                names.append(name)
                rows.append(row)
            continue
        record = json.loads((BOARDS / f"phantom-reference/agents/{name}.json").read_text())
        own, cells, seconds = record["scores"]["metrics"]["success_true"], [], 0.0
        for tier in TIERS:
            told = json.loads(place(name, tier).read_text())
            cells += [percent(told["success_declared"]), percent(told["reached"])]
            seconds += told["seconds"]
            for key in SHARES[:2]:
                whole[key] = max(whole[key], round(100 * told[key]["value"], 1))
        if f"`{name}`" not in told_before:
            whole["minutes"] += round(seconds / 60)
        sees = {"params": "pose", "multimodal": "both"}.get(told["sees"], told["sees"])
        names.append(name)
        rows.append([f"`{name}`", view, sees, str(told["trainings"]), percent(own), *cells])
    asked = () if names == list(AGENTS) else names
    columns = ["agent", "view", "sees", "trainings", "its own heart, found"]
    for title in TIERS.values():
        columns += [f"{title}: found and declared", f"{title}: passed through"]
    return {
        "schema": "racines.figures/1",
        "what": "published policies of the one heart on test patients; shares: the highest of all",
        "machine": "one core of an AMD EPYC",
        "source": "measured once",
        "command": " ".join(["python -m tests.envs.studies.carry_over", *asked]),
        "figures": {"patients": CONFIG.patients, **whole},
        "tables": {"agents": {"columns": columns, "rows": rows}},
    }


if __name__ == "__main__":
    for name in sys.argv[1:] or AGENTS:
        for tier in TIERS:
            if not place(name, tier).is_file():
                write_json(place(name, tier), act(name, tier))
                print(place(name, tier), flush=True)
    write_json(RESULT, figures(json.loads(RESULT.read_text(encoding="utf-8"))))
