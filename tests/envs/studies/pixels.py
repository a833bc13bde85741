"""How exactly the published servos read, at half of the pixels a side and at all of them.

    python -m tests.envs.studies.pixels

Frames of validation patients, still and beating, the same for both; those at hand are so near to a
view that there an agent decides whether to rest.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from racines_data.files import write_json
from racines_data.patients.splits import seeds_of
from racines_envs.agents.servo.agent import ServoAgent
from racines_envs.agents.servo.frames import FrameConfig, Frames, shard, shrink
from racines_envs.agents.servo.learner import Bank, ServoLearner
from racines_envs.evaluation.trainings import find_trainings
from racines_models.provenance import environment

ROOT = Path(__file__).parents[3]
RESULT, WEIGHTS = ROOT / "docs/results/pixels.json", ROOT / "envs/weights"
KEPT = Path("envs/runs/servo-full-frames")
SERVOS = ("servo", "servo-full")
PATIENTS, FRAMES = 8, FrameConfig(frames=900, places=8)
ERRORS = {
    "position_error": "along an axis, mm",
    "rotation_error": "about an axis, °",
    "at_hand_position_error": "at hand, mm",
    "at_hand_rotation_error": "at hand, °",
}


def seen(side: int, patient: int) -> Frames:
    """Return a patient's frames as a network of so many pixels a side sees them."""
    frames = shard(patient, FRAMES, KEPT, 128)
    return frames._replace(images=shrink(frames.images, side))


def read(name: str) -> dict[str, Any]:
    """Return the mean errors of a servo's trainings, and its size."""
    rows, patients = [], seeds_of("validation")[:PATIENTS]
    for each in find_trainings(WEIGHTS / name):
        agent = ServoAgent.load(each.folder)
        held = Bank(patients, FRAMES.frames, partial(seen, agent.network.side), agent.network.side)
        config = replace(agent.config, device="cpu")
        learner = ServoLearner(config, held, held, each.seed, agent.network)
        rows.append(learner.look(0, Path()))
    means = {key: sum(row[f"validation/{key}"] for row in rows) / len(rows) for key in ERRORS}
    weights = sum(each.numel() for each in agent.network.parameters())
    return {"side": agent.network.side, "weights": weights, "trainings": len(rows), **means}


def figures() -> dict[str, Any]:
    """Return the table of both."""
    found = {name: read(name) for name in SERVOS}
    rows = [
        [f"`{name}`", str(each["side"]), f"{each['weights'] / 1e6:.1f}",
         *(f"{each[key]:.1f}" for key in ERRORS)]
        for name, each in found.items()
    ]  # fmt: skip
    columns = ["", "pixels a side", "million weights", *ERRORS.values()]
    return {
        "schema": "racines.figures/1",
        "what": "mean errors of single readings of validation frames, three trainings each",
        "command": "python -m tests.envs.studies.pixels",
        "machine": f"one core of a shared {environment('cpu')['cpu']}",
        "source": "measured once",
        "figures": {"patients": PATIENTS, "frames": PATIENTS * FRAMES.frames},
        "tables": {"pixels": {"columns": columns, "right": 1, "rows": rows}},
    }  # fmt: skip


if __name__ == "__main__":
    write_json(RESULT, figures())
