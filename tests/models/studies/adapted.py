"""What the documentation says of generators that adapt, from the scores of the command.

racines eval generator NAME --tier patients --profile reference --out FOLDER
python -m tests.models.studies.adapted FOLDER MACHINE
"""

import json
import sys
from pathlib import Path
from typing import Any

from racines_data.files import write_json
from tests.models.studies.judged import number

OUT = Path(__file__).parents[3] / "docs/results/patient-generators.json"
METRICS = {
    "ssim": ("SSIM", 3), "psnr": ("PSNR, dB", 2), "kid": ("KID", 3), "fid": ("FID", 0),
    "pose_error_mm": ("pose error, mm", 1), "pose_error_deg": ("pose error, °", 1),
    "dice": ("Dice", 3),
}  # fmt: skip
ORDER = ("mean-image", "nearest-pose", "scout-attention", "noise-ceiling")


def main(folder: Path, machine: str) -> None:
    """Write the tables: all poses, and each stratum."""
    found = [json.loads((folder / f"{name}.json").read_text()) for name in ORDER]
    split, n = found[0]["dataset"]["split"], found[0]["metrics"]["ssim"]["n"]
    units = found[0]["metrics"]["ssim"]["settings"]["units"]
    heads = [title for title, _ in METRICS.values()]
    rows = [[each["generator"], *_figures(each["metrics"])] for each in found]
    strata: dict[str, Any] = {}
    for each in found:
        for title, metrics in each["by_stratum"].items():
            strata.setdefault(title, []).append([title, each["generator"], *_figures(metrics)])
    trainings = {each["generator"]: each["runs"] for each in found if each["trained"]}
    adapting = found[ORDER.index("scout-attention")]["metrics"]["seconds_to_adapt"]["value"]
    told = {
        "schema": "racines.figures/1",
        "what": f"generators on {units} {split} patients, {n} poses; trainings: {trainings}",
        "command": "racines eval generator NAME --tier patients --profile reference --out FOLDER, "
        "of what learned with --run models/weights/patients/NAME; "
        "python -m tests.models.studies.adapted FOLDER MACHINE",
        "machine": machine,
        "source": "measured once",
        "figures": {"patients": units, "poses": n, "seconds_to_adapt": round(adapting, 2)},
        "tables": {
            "all": {"columns": ["method", *heads], "rows": rows},
            "strata": {
                "columns": ["distance", "method", *heads], "rows": sum(strata.values(), [])
            },
        },
    }  # fmt: skip
    write_json(OUT, told)


def _figures(metrics: dict[str, Any]) -> list[str]:
    return [
        number(metrics[key], digits) if metrics[key]["low"] is not None else "–"
        for key, (_, digits) in METRICS.items()
    ]


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
