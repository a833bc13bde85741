"""What the documentation says of an agent's robustness and of ejection fractions at its views.

racines eval robustness servo --run envs/weights/servo --out ROBUSTNESS.json
racines study ejection servo --run envs/weights/servo --split test --patients 140 \\
    --out EJECTION.json
python -m tests.envs.studies.figures REPORT.json …    # either, of any agent
"""

import json
import sys
from pathlib import Path
from typing import Any

from racines_data.files import write_json
from racines_envs.studies.robustness.disturbances import STRENGTHS
from racines_envs.studies.robustness.run import NOTHING, RANKED, changes

RESULTS = Path(__file__).parents[3] / "docs/results"
MACHINE = "one core of an AMD EPYC"
VOLUMES = {
    "end_diastolic_volume": "end-diastolic volume",
    "end_systolic_volume": "end-systolic volume",
    "long_axis": "long axis",
}


def points(change: dict[str, Any] | None) -> str:
    """Return a change and its interval, percentage points."""
    if change is None:
        return "–"
    value, low, high = (f"{100 * change[key]:+.0f}" for key in ("value", "low", "high"))
    return f"{value} ({low} to {high})"


def robustness(report: dict[str, Any]) -> dict[str, Any]:
    """Return the figures of a robustness study."""
    base, agent = report["conditions"][NOTHING]["metrics"][RANKED], report["agent"]
    rows = [[name, *map(points, found)] for name, found in changes(report)]
    worst = rows[1][0] if rows[0][0] == "all" else rows[0][0]
    units = base["settings"]["units"]
    return {
        "what": f"what each disturbance costs {agent} on still hearts of {units} validation "
        "patients: change of the share found and declared, percentage points",
        "command": f"racines eval robustness {agent} --run envs/weights/{agent}; python -m "
        "tests.envs.studies.figures REPORT.json",
        "figures": {
            "base": round(100 * base["value"]), "patients": units,
            "minutes": round(report["seconds"] / 60), "worst": worst,
        },
        "tables": {"changes": {"columns": ["disturbance", *STRENGTHS], "rows": rows}},
    }  # fmt: skip


def number(told: dict[str, Any], sign: str = "+", digits: int = 1) -> str:
    """Return a figure and its interval."""
    value, low, high = (f"{told[key]:{sign}.{digits}f}" for key in ("value", "low", "high"))
    return f"{value} ({low} to {high})"


def ejection(report: dict[str, Any]) -> dict[str, Any]:
    """Return the figures of a study of ejection fractions."""
    rows = []
    for title, told in report["agreement"].items():
        each = told["ejection_fraction"]
        limits = f"{each['lower_limit']['value']:+.0f} to {each['upper_limit']['value']:+.0f}"
        left_out = each["not_seen"] + each["impossible"]
        rows.append([title, number(each["bias"]), limits, number(each["correlation"], "", 2),
                     str(each["patients"]), str(left_out)])  # fmt: skip
    columns = ["pose, outlines", "bias, points", "limits of agreement", "correlation", "measured",
               "not measured"]  # fmt: skip
    further = ["pose, outlines", "of", "bias", "limits of agreement", "correlation"]
    starts, agent = report["task"]["start_set"], report["agent"]
    short = {
        f"foreshortened_{pose}": round(-told["bias"]["value"], 1)
        for pose, told in report["foreshortening"].items()
    }
    return {
        "what": f"ejection fractions at A4C as {agent} found it, {starts['patients']} "
        f"{starts['split']} patients, against the truth",
        "command": f"racines study ejection {agent} --run envs/weights/{agent} --split test "
        "--patients 140; python -m tests.envs.studies.figures REPORT.json",
        "figures": {
            "patients": starts["patients"],
            "frames": report["frames"],
            "found": round(100 * report["found_and_declared"]),
            **{name: round(value, 1) for name, value in report["errors"].items()},
            **short,
        },
        "tables": {
            "agreement": {"columns": columns, "rows": rows},
            "volumes": {"columns": further, "rows": volumes(report)},
        },
    }  # fmt: skip


def volumes(report: dict[str, Any]) -> list[list[str]]:
    """Return the rows on volumes and the long axis, by pose and outlines."""
    rows = []
    for title, told in report["agreement"].items():
        for name, title_of in VOLUMES.items():
            each = told[name]
            low, high = (each[f"{end}_limit"]["value"] for end in ("lower", "upper"))
            bias = f"{number(each['bias'])} {each['bias']['unit']}"
            rows.append([title, title_of, bias, f"{low:+.0f} to {high:+.0f}",
                         number(each["correlation"], "", 2)])  # fmt: skip
    return rows


if __name__ == "__main__":
    for file in sys.argv[1:]:
        report = json.loads(Path(file).read_text(encoding="utf-8"))
        name, make = ("ejection", ejection) if "agreement" in report else ("robustness", robustness)
        named = name if report["agent"] == "servo" else f"{name}-{report['agent']}"
        about = {"schema": "racines.figures/1", "machine": MACHINE, "source": "measured once"}
        write_json(RESULTS / f"{named}.json", about | make(report))
