"""What a policy on the servo's belief needs: which memory, lessons, which reward; one at a time.

    python -m tests.envs.studies.belief_ablation        # or some: … all alone stack

A4C of still hearts; three trainings a way, each through another training of the servo. The best
look of a training is chosen on the first validation patients, and it is judged on others. What is
trained is kept in `envs/runs/belief-ablation`, by its settings: a study that was killed goes on.
"""

import json
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from racines_data.digest import recipe_digest
from racines_data.files import write_json
from racines_data.patients.splits import seeds_of
from racines_envs.agents.belief.agent import PPOBeliefAgent, PPOBeliefConfig
from racines_envs.evaluation.measures import measure_patients, patient_values
from racines_envs.evaluation.patients import PatientsConfig, StartSet, act_on_patients
from racines_models.provenance import environment
from tests.envs.studies.patients_curve import percent

ROOT = Path(__file__).parents[3]
RESULT = ROOT / "docs/results/belief-ablation.json"
KEPT, METRICS = Path("envs/runs/belief-ablation"), "seed-*/metrics.json"
TRAININGS, FRAMES = 3, 102_400
BASE = PPOBeliefConfig(
    view="A4C-patients", members="envs/weights/servo", patients=32, frames=FRAMES,
    imitate=FRAMES // 4, validate_every=FRAMES // 2, validation_starts=50,
)  # fmt: skip
WAYS: dict[str, tuple[str, Mapping[str, Any]]] = {
    "all": ("all of it: the servo's belief for a memory", {}),
    "alone": ("no memory: the last image alone", {"memory": False}),
    "stack": ("a frame stack for a memory: the last 4 images", {"memory": False, "window": 4}),
    "gru": (
        "a GRU for a memory, of the last 16 images",
        {"memory": False, "window": 16, "recurrent": True},
    ),
    "reward": ("no lessons: reward alone", {"imitate": 0}),
    "discount": ("a discount of 0.99 a step: less haste", {"gamma": 0.99}),
    "paper": (
        "the paper's reward, after the lessons",
        {"reward": "paper", "grader": "models/weights/phantom-patients/grader"},
    ),
    "oracle": ("the oracle's reward, after the lessons", {"reward": "oracle"}),
    "lessons": ("lessons alone", {"imitate": FRAMES}),
}
"""How each is told, and what is set otherwise."""
JUDGED = PatientsConfig(view="A4C-patients", split="validation", patients=40, starts=3)
STARTS = StartSet(tuple(seeds_of("validation")[100 : 100 + JUDGED.patients]), JUDGED.starts, 0)
SHARES = {"success_declared": "found and declared", "reached": "passed through"}


def trained(way: str, seed: int, base: PPOBeliefConfig = BASE) -> PPOBeliefAgent:
    """Return the policy of a training, trained if it is not kept."""
    config = replace(base, **WAYS[way][1])
    folder = KEPT / recipe_digest(asdict(config))[:12] / f"seed-{seed}"
    if not (folder / "metrics.json").is_file():
        began = time.perf_counter()
        PPOBeliefAgent.train(config, folder, seed=seed, progress=False)
        print(folder, f"{time.perf_counter() - began:.0f} s", flush=True)
    return PPOBeliefAgent.load(folder)


def point(way: str, base: PPOBeliefConfig = BASE, starts: StartSet = STARTS) -> dict[str, Any]:
    """Return what policies of a way find."""
    config = asdict(replace(base, **WAYS[way][1]))
    about = {"starts": starts._asdict(), "trainings": TRAININGS, "config": config}
    path = KEPT / recipe_digest(config)[:12] / f"{recipe_digest(about)[:12]}.json"
    if not path.is_file():
        agents = [trained(way, seed, base) for seed in range(TRAININGS)]
        acted = act_on_patients(agents, replace(JUDGED, view=base.view), starts)
        metrics, _ = measure_patients(patient_values(acted), starts.units)
        steps = metrics["episode_steps"]["value"]
        write_json(path, {"steps": steps, **{key: metrics[key] for key in SHARES}})
        print(path.read_text(encoding="utf-8"), flush=True)
    seconds = [json.loads(each.read_text())["seconds"] for each in path.parent.glob(METRICS)]
    return json.loads(path.read_text(encoding="utf-8")) | {"seconds": seconds}


def figures(points: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the table of the ways' points."""
    rows = [
        [WAYS[way][0], *(percent(each[key]) for key in SHARES), f"{each['steps']:.0f}"]
        for way, each in points.items()
    ]
    asked = () if list(points) == list(WAYS) else points
    levels = [each[key]["settings"]["level"] for each in points.values() for key in SHARES]
    minutes = [each / 60 for point in points.values() for each in point["seconds"]]
    return {
        "schema": "racines.figures/1",
        "what": "policies on the servo's belief, one part left out or in another's place, A4C of "
        "still validation patients",
        "command": " ".join(["python -m tests.envs.studies.belief_ablation", *asked]),
        "machine": f"one core of a shared {environment('cpu')['cpu']}",
        "source": "measured once",
        "figures": {
            "frames": FRAMES, "trainings": TRAININGS, "patients": JUDGED.patients,
            "starts": JUDGED.starts, "learned": BASE.patients, "level": round(100 * min(levels)),
            "minutes_least": round(min(minutes)), "minutes_most": round(max(minutes)),
        },
        "tables": {"ablation": {"columns": ["", *SHARES.values(), "steps"], "rows": rows}},
    }  # fmt: skip


if __name__ == "__main__":
    if unknown := set(sys.argv[1:]) - set(WAYS):
        sys.exit(f"no such way: {', '.join(sorted(unknown))}; there are {', '.join(WAYS)}")
    write_json(RESULT, figures({way: point(way) for way in sys.argv[1:] or WAYS}))
