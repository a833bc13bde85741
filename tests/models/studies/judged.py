"""What the documentation says of the judges of patients, from the reports of the commands.

racines eval grader JUDGES/grader --config patients --json > STILL.json
racines study sim-to-real --real FOLDER --grader JUDGES/grader --segmentation JUDGES/segmentation
python -m tests.models.studies.judged STILL.json SIM_TO_REAL.json
python -m tests.models.studies.judged STILL.json SIM_TO_REAL.json servo    # of grader-servo
python -m tests.models.studies.judged - SIM_TO_REAL.json acceptance    # of models/weights/grader
"""

import json
import sys
from pathlib import Path
from typing import Any

from racines_data.files import write_json

RESULTS = Path(__file__).parents[3] / "docs/results"
LISTS = ("tuning", "reporting")
CONTROLS = ("as they are", "upside down", "scrambled", "mirrored")
SECTORS = {
    "A4C": "one heart turned 0°–15° (A4C)",
    "between": "one heart turned 45°–135° (between)",
    "A4C mirrored": "one heart turned 165°–180° (A4C mirrored)",
}
OUTLINES = {"dice_lv": "Dice, LV", "dice_lv_myocardium": "Dice, myocardium", "dice_la": "Dice, LA"}


def share(told: dict[str, Any]) -> str:
    """Return a share and its interval, per cent."""
    value, low, high = (f"{100 * told[key]:.1f}" for key in ("value", "low", "high"))
    return f"{value} % ({low} – {high})"


def number(told: dict[str, Any], digits: int = 2) -> str:
    """Return a figure and its interval."""
    value, low, high = (f"{told[key]:.{digits}f}" for key in ("value", "low", "high"))
    return f"{value} ({low} – {high})"


def accepted(report: dict[str, Any]) -> dict[str, Any]:
    """Return the table of what is called A4C."""
    rows = []
    for control in CONTROLS:
        own = [report["acceptance"][name][control]["called_a4c"] for name in LISTS]
        counts = ", ".join(str(each["n"]) for each in own)
        sure = report["acceptance"][LISTS[1]][control]["surely_a4c"]
        rows.append([f"A4C, {control}", *map(share, own), share(sure), counts])
    others = report["other_views"]["others_called_a4c"]
    rows.append(["other views", "–", share(others), "–", str(others["n"])])
    for name, title in SECTORS.items():
        own = report["rotation"]["sectors"][name]
        shares = [f"{100 * own[key]:.1f} %" for key in ("called_a4c", "surely_a4c")]
        rows.append([title, "–", *shares, str(own["frames"])])
    columns = ["frames, called A4C", *LISTS, "reporting, with p ≥ 0.9", "n"]
    return {"columns": columns, "rows": rows}


def pictures(report: dict[str, Any]) -> dict[str, Any]:
    """Return the table of what single pictures are called."""
    told = report["other_views"]["pictures"]
    return {
        "columns": ["view", "called"],
        "rows": [[each["view"], each["called"]] for each in told],
    }


def outlined(report: dict[str, Any]) -> dict[str, Any]:
    """Return the table of outlines and ejection fractions against cardiologists."""
    rows = []
    for key in report["overlap"][LISTS[0]]:
        if key in OUTLINES:
            own = [report["overlap"][name][key] for name in LISTS]
            counts = ", ".join(str(each["n"]) for each in own)
            rows.append([OUTLINES[key], *map(number, own), counts])
    for key, title in (("bias", "bias"), ("absolute", "mean absolute difference"),
                       ("correlation", "correlation")):  # fmt: skip
        own = [report["volumes"][name]["ejection_fraction"].get(key) for name in LISTS]
        if all(own):
            counts = ", ".join(str(each["n"]) for each in own)
            digits = 2 if key == "correlation" else 1
            cells = [number(each, digits) for each in own]
            rows.append([f"ejection fraction, {title}", *cells, counts])
    return {"columns": ["against cardiologists", *LISTS, "n"], "rows": rows}


def fill(still: dict[str, Any] | None, report: dict[str, Any], judge: str = "grader") -> None:
    """Write the figures and tables of the grader, or of the one that begins as a servo.

    Without what is said of still patients, the table of real frames alone.
    """
    path = RESULTS / "sim-to-real.json"
    content = json.loads(path.read_text())
    if judge == "grader":
        content["tables"] |= {"patients": accepted(report), "pictures": pictures(report)}
        if "overlap" in report:
            content["tables"]["outlines"] = outlined(report)
    else:
        content["tables"][judge] = accepted(report)
    write_json(path, content)
    if still is None:
        return
    path = RESULTS / "patients-judges.json"
    content = json.loads(path.read_text())
    metrics = still["metrics"]
    figures = {
        "balanced_accuracy": share(metrics["balanced_accuracy"]),
        "random": share(still["views"]["Random"]),
        "grade_mae": number(metrics["grade_mae"]),
    }
    content["figures"][judge] = {"still": figures}
    write_json(path, content)


if __name__ == "__main__":
    still, report = (Path(name) for name in sys.argv[1:3])
    told = None if str(still) == "-" else json.loads(still.read_text(encoding="utf-8"))
    fill(told, json.loads(report.read_text(encoding="utf-8")), *sys.argv[3:])
