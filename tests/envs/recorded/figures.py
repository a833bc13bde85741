"""What the documentation says of replays: scores that `racines eval agent` wrote, as a table.

python -m tests.envs.recorded.figures SCORES.json …     # rows of other recordings stay
"""

import json
import sys
from pathlib import Path
from typing import Any

from racines_data.files import write_json

RESULTS = Path(__file__).parents[3] / "docs/results"
COLUMNS = ["recordings", "starts", "agent", "success", "steps", "refused steps"]
COMMAND = (
    "racines data build --source phantom --profile abdomen --frames 8000 --out abdomen; "
    "racines train agent ppo --env replay:abdomen --view KLX --profile abdomen --frames 300000; "
    "racines eval agent AGENT --env replay:abdomen --view KLX --split SPLIT --profile abdomen "
    "--starts 100 --set seeds=[0] --set latency=0; racines data import neuralcmf --source rotation "
    "--out rotation; racines data import *.igs.mha --source tracked --out tracked; likewise with "
    "rotation --goal turn-0100:0 "
    "--set reach=20 --frames 100000, and with tracked --goal SESSION-02:3 --set session=SESSION "
    "--set within=3 without a training; racines data build --source phantom --frames 6000 --out "
    "built; racines data export built --format release --out tree; racines data import tree "
    "--source release --out released; racines data annotate released --grader "
    "models/weights/grader, and with released --view SC without a training; "
    "python -m tests.envs.recorded.figures SCORES.json"
)


def percent(told: dict[str, Any]) -> str:
    """Return a share and its interval, %."""
    value, low, high = (f"{100 * told[key]:.0f}" for key in ("value", "low", "high"))
    return f"{value} % ({low} – {high})"


def row_of(scores: dict[str, Any]) -> tuple[str, str, str]:
    """Return which recordings, split and agent scores are of."""
    told = scores["phantom"]
    settings, source = told["settings"], told["dataset"]["source"]
    known = {
        "phantom": "abdomen, KLX",
        "rotation": "echo, one turn",
        "release": "release layout, SC",
    }
    title = known.get(source) or settings["session"].removesuffix("Freehand").replace(
        "Phantom", " phantom"
    )
    return title, settings["split"], scores["submission"]


def document(paths: list[Path]) -> dict[str, Any]:
    """Return the figures of scores, one file each."""
    rows, figures = [], {}
    for path in paths:
        scores = json.loads(path.read_text())
        title, split, agent = row_of(scores)
        metrics, told = scores["metrics"], scores["phantom"]
        steps, refused = metrics["episode_steps"]["value"], metrics["violations"]["value"]
        success = metrics["success_true"]
        where = f"{split}: {told['starts']} frames; in {success['settings']['units']} trajectories"
        rows.append([title, where, agent, percent(success), f"{steps:.0f}", f"{refused:.0f}"])
        key = f"{told['dataset']['source']}_{split}_{agent}"
        if split == "test" and agent == "ppo":
            figures[f"{key}_percent"] = round(100 * success["value"])
        if split == "test" and agent == "planner":
            cut = told["starts_cut_off"]
            figures[f"{told['dataset']['source']}_cut_off"] = cut
            figures[f"{told['dataset']['source']}_could_start"] = cut + told["starts"]
            figures[f"{told['dataset']['source']}_reach"] = round(told["settings"]["reach"], 1)
    return {
        "schema": "racines.figures/1",
        "what": "success of agents in recordings alone, from 100 starts each",
        "command": COMMAND,
        "machine": "one core of a shared AMD EPYC",
        "source": "measured once",
        "figures": figures,
        "tables": {"success": {"columns": COLUMNS, "right": 3, "rows": rows}},
    }


def main(paths: list[Path]) -> None:
    """Put the rows of scores in the place of those of the same recordings, and after the others."""
    path = RESULTS / "replay.json"
    made, there = document(paths), json.loads(path.read_text(encoding="utf-8"))
    made["figures"] = there["figures"] | made["figures"]
    rows = made["tables"]["success"]["rows"]
    titles = {row[0] for row in rows}
    kept = [row for row in there["tables"]["success"]["rows"] if row[0] not in titles]
    made["tables"]["success"]["rows"] = kept + rows
    write_json(path, made)


if __name__ == "__main__":
    main([Path(each) for each in sys.argv[1:]])
