"""What the documentation says of generators on patients, from the records of their board.

racines eval generator NAME --tier patients --profile reference --out FOLDER
racines leaderboard --board patients --collect FOLDER
python -m tests.models.studies.adapted MACHINE
"""

import json
import sys
from pathlib import Path
from typing import Any

from racines_data.files import write_json
from racines_models.statistics import Evidence
from racines_models.statistics.intervals import difference
from tests.models.studies.judged import number

OUT = Path(__file__).parents[3] / "docs/results/patient-generators.json"
BOARD = OUT.parents[2] / "leaderboard/results/patients/patient-generators"
METRICS = {
    "ssim": ("SSIM", 3), "psnr": ("PSNR, dB", 2), "kid": ("KID", 3), "fid": ("FID", 0),
    "pose_error_mm": ("pose error, mm", 1), "pose_error_deg": ("pose error, °", 1),
    "dice": ("Dice", 3),
}  # fmt: skip
ORDER = ("mean-image", "nearest-pose", "scout-attention", "scout-field", "noise-ceiling")
AHEAD = (
    ("scout-field", "nearest-pose"), ("scout-attention", "nearest-pose"),
    ("scout-field", "scout-attention"),
)  # fmt: skip
"""Who is compared with whom, patient by patient."""
COMPARED = ("ssim", "psnr", "kid", "pose_error_mm", "dice")
ONE_HEART = ("vae-gan", "cgan", "flow", "scene-field")
"""Trained on the one heart: they ignore the patient."""


def main(machine: str) -> None:
    """Write the tables: all poses, each stratum, and those who ignore the patient."""
    found = [_read(name) for name in ORDER]
    ignoring = [_read(name) for name in ONE_HEART]
    split, n = found[0]["dataset"]["split"], found[0]["metrics"]["ssim"]["n"]
    units = found[0]["metrics"]["ssim"]["settings"]["units"]
    heads = [title for title, _ in METRICS.values()]
    rows = [[each["generator"], *_figures(each["metrics"])] for each in found]
    strata: dict[str, Any] = {}
    for each in found:
        for title, metrics in each["by_stratum"].items():
            strata.setdefault(title, []).append([title, each["generator"], *_figures(metrics)])
    trainings = {each["generator"]: each["runs"] for each in found + ignoring if each["trained"]}
    heart = [[f"`{each['generator']}`", str(each["runs"]), *_figures(each["metrics"])]
             for each in (*ignoring, found[0], found[1])]  # fmt: skip
    seconds = {
        name: round(found[ORDER.index(name)]["metrics"]["seconds_to_adapt"]["value"], 2)
        for name in ("scout-attention", "scout-field")
    }
    told = {
        "schema": "racines.figures/1",
        "what": f"generators on {units} {split} patients, {n} poses; trainings: {trainings}",
        "command": "racines eval generator NAME --tier patients --profile reference --out FOLDER, "
        "of what learned on the one heart with --run models/weights/NAME; "
        "racines leaderboard --board patients --collect FOLDER; "
        "python -m tests.models.studies.adapted MACHINE",
        "machine": machine,
        "source": "measured once",
        "figures": {"patients": units, "poses": n, "seconds_to_adapt": seconds},
        "tables": {
            "all": {"columns": ["method", *heads], "rows": rows},
            "gains": {
                "columns": ["method", "beside", *(METRICS[key][0] for key in COMPARED)],
                "rows": [_gains(*pair) for pair in AHEAD],
            },
            "one_heart": {"columns": ["generator", "trainings", *heads], "rows": heart},
            "strata": {
                "columns": ["distance", "method", *heads], "rows": sum(strata.values(), [])
            },
        },
    }  # fmt: skip
    write_json(OUT, told)


def _read(name: str) -> dict[str, Any]:
    return json.loads((BOARD / f"{name}.json").read_text())["scores"]


def _gains(one: str, other: str) -> list[str]:
    """Return a row of what one has more than another, paired by patient."""
    both = [Evidence.read(BOARD / f"{name}.parquet").figures for name in (one, other)]
    cells = []
    for key in COMPARED:
        gain, digits = difference(*(each[key].replicates() for each in both)), METRICS[key][1]
        assert gain.low is not None and gain.high is not None
        value, low, high = (f"{x:+.{digits}f}" for x in (gain.value, gain.low, gain.high))
        cells.append(f"{value} ({low} to {high})")
    return [one, other, *cells]


def _figures(metrics: dict[str, Any]) -> list[str]:
    return [
        number(metrics[key], digits) if metrics[key]["low"] is not None else "–"
        for key, (_, digits) in METRICS.items()
    ]


if __name__ == "__main__":
    main(sys.argv[1])
