"""What docs/rotation.md says of a split: scores of generators, and their lead over retrieval.

python -m tests.models.turns.figures interpolation echo/scores
python -m tests.models.turns.figures judged gap=echo/judged-gap interpolation=echo/judged
"""

import json
import sys
from pathlib import Path
from typing import Any

import yaml

from racines_data.files import write_atomic
from racines_models.statistics import Evidence
from racines_models.statistics.intervals import difference

ROOT = Path(__file__).parents[3]
RESULT, PARAMS = ROOT / "docs/results/echo-rotation.json", "leaderboard/params/echo-rotation.yaml"
FLOOR = "nearest-pose"
LEARNED = ("scene-field", "cgan", "vae-gan", "flow")
SHOWN = {"ssim": 3, "psnr": 2, "feature_distance": 2, "fid": 0, "kid": 3}
"""Metrics of the table, with digits; those of the differences are the first three."""
OTHERS = {"neighbour": "(bound) next turn", "train": "(leak) nearest training turn"}
"""Rows that the floor's scores have besides, by the end of their metrics' names."""
JUDGED = "feature_distance_grader"
SPLITS = {"gap": "one gap", "interpolation": "narrow blocks"}
TITLES = ["SSIM", "PSNR, dB", "distance in features", "FID", "KID"]


def cell(metric: dict[str, Any], digits: int) -> str:
    """Return a value with its interval."""
    value, low, high = (f"{metric[key]:.{digits}f}" for key in ("value", "low", "high"))
    return f"{value} ({low} to {high})"


def table(folder: Path) -> dict[str, Any]:
    """Return the table of a folder of scores: the bound, generators, floors, the leak."""
    settings = yaml.safe_load((ROOT / PARAMS).read_text())["generators"]
    floor = json.loads((folder / f"{FLOOR}.json").read_text())["metrics"]

    def beside(kind: str) -> list[str]:
        told = (cell(floor[f"{key}_{kind}"], digits) for key, digits in SHOWN.items())
        return [OTHERS[kind], "–", "–", *told]

    rows = [beside("neighbour")]
    for name in (*LEARNED, FLOOR, "mean-image"):
        scores = json.loads((folder / f"{name}.json").read_text())
        images = (settings[name].get("training") or {}).get("images")
        told = [str(scores["runs"]), f"{images:,}"] if scores["trained"] else ["–", "–"]
        rows.append([name, *told, *(cell(scores["metrics"][k], d) for k, d in SHOWN.items())])
    rows.append(beside("train"))
    columns = ["generator", "trainings", "images each", *TITLES]
    return {"columns": columns, "rows": rows}


def leads(folder: Path) -> dict[str, Any]:
    """Return the table of differences from the floor, on the same frames."""
    kept = {name: Evidence.read(folder / f"{name}.parquet").figures for name in (*LEARNED, FLOOR)}
    rows = []
    for name in LEARNED:
        told = []
        for key, digits in list(SHOWN.items())[:3]:
            found = difference(kept[name][key].replicates(), kept[FLOOR][key].replicates())
            low, high = found.low, found.high
            told.append(f"{found.value:+.{digits}f} ({low:+.{digits}f} to {high:+.{digits}f})")
        rows.append([name, *told])
    return {"columns": [f"generator – {FLOOR}", *TITLES[:3]], "rows": rows}


def judged(folders: dict[str, Path]) -> dict[str, Any]:
    """Return the table of distances in a grader's features: of retrieval, and what others add."""
    rows = []
    for split, folder in folders.items():
        kept = {each.stem: Evidence.read(each).figures for each in folder.glob("*.parquet")}
        floor = kept[FLOOR][JUDGED]
        scores = json.loads((folder / f"{FLOOR}.json").read_text())["metrics"][JUDGED]
        rows.append([SPLITS[split], FLOOR, cell(scores, 2), "–"])
        for name in LEARNED:
            if name in kept:
                scores = json.loads((folder / f"{name}.json").read_text())["metrics"][JUDGED]
                found = difference(kept[name][JUDGED].replicates(), floor.replicates())
                told = f"{found.value:+.2f} ({found.low:+.2f} to {found.high:+.2f})"
                rows.append([SPLITS[split], name, cell(scores, 2), told])
    columns = ["held out", "generator", "distance in the grader's features", f"minus {FLOOR}"]
    return {"columns": columns, "rows": rows}


def main(split: str, *given: str) -> None:
    """Write both tables of a split, or that of the judge."""
    document = json.loads(RESULT.read_text())
    if split == "judged":
        pairs = [each.split("=", 1) for each in given]
        document["tables"]["judged"] = judged({name: Path(folder) for name, folder in pairs})
    else:
        folder = Path(given[0])
        document["tables"] |= {split: table(folder), f"{split}_difference": leads(folder)}
    write_atomic(RESULT, json.dumps(document, indent=2, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
