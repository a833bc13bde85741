"""What the documentation shows of real echo: the report's charts, the one of turns by two graders.

racines study sim-to-real --real FOLDER --grader JUDGES/grader --segmentation JUDGES/segmentation
python -m tests.models.studies.real_charts FOLDER SIM_TO_REAL.json

FOLDER has a rotation whose frames may be shown. Frames of patients are in none of the charts.
"""

import json
import sys
from pathlib import Path
from typing import Any

import torch
from matplotlib.figure import Figure

from racines_data.files import write_atomic, write_json
from racines_data.plotting import card_style, encode
from racines_models.judges.grader.model import Grader
from racines_models.published.places import WEIGHTS
from racines_models.studies.sim_to_real.acceptance import accepted_turns, call
from racines_models.studies.sim_to_real.charts import (
    Turned,
    ejection_figure,
    shares_figure,
    turns_figure,
)
from racines_models.studies.sim_to_real.frames import Rotation, read_real_echo
from tests.models.studies.judged import LISTS, RESULTS

IMAGES = RESULTS.parent / "images"
GRADERS = {
    "grader of simulated patients": WEIGHTS / "phantom-patients/grader",
    "grader of one simulated heart": WEIGHTS / "grader",
}


def asked(grader: Grader, rotation: Rotation) -> Turned:
    """Return what a grader says of the turns."""
    called = call(grader, rotation.images)
    return Turned(called, accepted_turns(called, rotation, grader.labels))


def quoted(report: dict[str, Any]) -> dict[str, Any]:
    """Return by list in how many patients there is an ejection fraction, and its limits."""
    told = {}
    for name in LISTS:
        fraction = report["volumes"][name]["ejection_fraction"]
        counts = {key: fraction[key] for key in ("patients", "not_seen", "impossible")}
        limits = {key: fraction[key]["value"] for key in ("lower_limit", "upper_limit")}
        told[name] = counts | limits
    return told


def charts(rotation: Rotation, report: dict[str, Any]) -> dict[str, Figure]:
    """Return the charts by the ending of their names."""
    graders = {name: asked(Grader.load(at), rotation) for name, at in GRADERS.items()}
    return {
        "acceptance": shares_figure(report["acceptance"], rotation),
        "turns": turns_figure(rotation, graders),
        "ejection": ejection_figure(report["volumes"]),
    }


def run(folder: Path, file: Path) -> None:
    """Draw the charts, and write the figures that the page quotes of them."""
    report, rotation = json.loads(file.read_text(encoding="utf-8")), read_real_echo(folder).rotation
    assert rotation is not None, f"{folder}: no rotation"
    with card_style():
        for name, figure in charts(rotation, report).items():
            png = encode(figure, few=name == "ejection")
            write_atomic(IMAGES / f"sim-to-real-{name}.png", png)
    path = RESULTS / "sim-to-real.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    content["figures"] |= {"ejection": quoted(report)}
    write_json(path, content)


if __name__ == "__main__":
    torch.set_num_threads(1)
    run(*map(Path, sys.argv[1:3]))
