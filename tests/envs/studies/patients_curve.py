"""What the number of train patients is worth: servos that learned of few hearts and of many.

    python -m tests.envs.studies.patients_curve

Each learns from the same number of images, and of its patients alone; three trainings a number.
What is trained is kept in `envs/runs/patients-curve`: a study that was killed goes on.
"""

import json
import time
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from racines_data.files import write_json
from racines_data.plotting import INK, card_style, colour
from racines_envs.agents.servo.agent import ServoAgent
from racines_envs.agents.servo.frames import FrameConfig
from racines_envs.agents.servo.learner import ServoConfig
from racines_envs.agents.servo.visits import VisitConfig
from racines_envs.evaluation.measures import measure_patients, patient_values
from racines_envs.evaluation.patients import PatientsConfig, act_on_patients, start_set
from racines_envs.evaluation.pictures import save
from racines_models.provenance import environment

ROOT = Path(__file__).parents[3]
RESULT, PICTURE = ROOT / "docs/results/patients-curve.json", ROOT / "docs/images/patients-curve.png"
KEPT = Path("envs/runs/patients-curve")
NUMBERS, TRAININGS = (10, 30, 100, 300), 3
IMAGES = 120_000
JUDGED = PatientsConfig(view="A4C-patients", split="validation", patients=40, starts=3)
SHARES = {"success_declared": "found and declared", "reached": "passed through"}


def trained(number: int, seed: int) -> tuple[ServoAgent, dict[str, float]]:
    """Return a servo of so many patients, and how it reads validation patients at the end."""
    folder = KEPT / f"{number}-seed-{seed}"
    config = ServoConfig(
        patients=number, frames=FrameConfig(frames=600), images=IMAGES,
        visits=VisitConfig(rounds=0), store=str(KEPT / "frames"),
    )  # fmt: skip
    if not (folder / "metrics.json").is_file():
        began = time.perf_counter()
        ServoAgent.train(config, folder, seed=seed, progress=False)
        print(folder, f"{time.perf_counter() - began:.0f} s", flush=True)
    history = json.loads((folder / "metrics.json").read_text())["history"]
    return ServoAgent.load(folder), history[-1]


def point(number: int) -> dict[str, Any]:
    """Return what servos of so many patients find."""
    path = KEPT / f"{number}.json"
    if not path.is_file():
        pairs = [trained(number, seed) for seed in range(TRAININGS)]
        agents, ends = zip(*pairs, strict=True)
        starts = start_set(JUDGED)
        metrics, _ = measure_patients(
            patient_values(act_on_patients(list(agents), JUDGED, starts)), starts.units
        )
        errors = {
            name: sum(end[f"validation/{name}"] for end in ends) / TRAININGS
            for name in ("position_error", "rotation_error")
        }
        write_json(path, {"number": number, **{key: metrics[key] for key in SHARES}, **errors})
        print(path.read_text(), flush=True)
    return json.loads(path.read_text())


@card_style()
def draw(points: list[dict[str, Any]], path: Path) -> None:
    """Draw the shares against the number of patients."""
    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.add_subplot()
    for place, (key, title) in enumerate(SHARES.items()):
        numbers = [each["number"] for each in points]
        told = [{end: 100 * each[key][end] for end in ("value", "low", "high")} for each in points]
        values = [each["value"] for each in told]
        ends = [[v["value"] - v["low"] for v in told], [v["high"] - v["value"] for v in told]]
        look = {"color": colour(place), "marker": "o", "capsize": 3, "label": title}
        axes.errorbar(numbers, values, ends, **look)
    axes.set_xscale("log")
    axes.set_xticks(NUMBERS, [str(number) for number in NUMBERS])
    axes.minorticks_off()
    axes.set_ylim(0, 100)
    axes.set_xlabel("train patients")
    axes.set_ylabel("share of starts, %")
    axes.legend(frameon=False, labelcolor=INK)
    save(figure, path)


def percent(told: dict[str, Any]) -> str:
    """Return a share and its interval."""
    value, low, high = (f"{100 * told[key]:.0f}" for key in ("value", "low", "high"))
    return f"{value} % ({low} – {high})"


def figures(points: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the table of the points."""
    rows = [
        [str(each["number"]), *(percent(each[key]) for key in SHARES),
         f"{each['position_error']:.1f} mm", f"{each['rotation_error']:.1f} °"]
        for each in points
    ]  # fmt: skip
    columns = ["train patients", *SHARES.values(), "error along an axis", "about an axis"]
    return {
        "schema": "racines.figures/1",
        "what": "servos of few and of many train patients, A4C of still validation patients",
        "command": "python -m tests.envs.studies.patients_curve",
        "machine": f"one core of a shared {environment('cpu')['cpu']}",
        "source": "measured once",
        "figures": {
            "images": IMAGES, "trainings": TRAININGS, "patients": JUDGED.patients,
            "starts": JUDGED.starts,
        },
        "tables": {"curve": {"columns": columns, "rows": rows}},
    }  # fmt: skip


if __name__ == "__main__":
    found = [point(number) for number in NUMBERS]
    write_json(RESULT, figures(found))
    draw(found, PICTURE)
