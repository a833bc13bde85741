"""What docs/trackerless.md says: scores of estimators, and how fast frames forget one another.

racines eval motion NAME --data DATA --out FOLDER
racines eval motion NAME --data TRACKED --config frames --split all --out FOLDER/tracked
racines eval motion NAME --data TRACKED --config frames --set pixel_mm=0.5125 --out FOLDER/nwire
python -m tests.models.trackerless.figures FOLDER

`figures FOLDER recorded` writes those of recordings alone, and the error of the same trainings on
simulated sweeps, scored into FOLDER/simulated.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, max_pool2d

from racines_data.files import write_json
from racines_data.geometry import Pose, rotate
from racines_data.patients import Pool
from racines_data.patients.splits import seeds_of
from racines_models.statistics import Evidence
from racines_models.statistics.intervals import difference

RESULT = Path(__file__).parents[3] / "docs/results/trackerless.json"
PLACES = {"": "simulated", "tracked": "tracked", "nwire": "nwire"}
"""Folders of scores within the one given, and the tables that they fill."""
SHOWN = {
    "simulated": ("gpe", "gle", "lpe", "lle", "score"),
    "nwire": ("gpe", "gle", "lpe", "lle"),
}
RANKED = {"simulated": "gpe", "nwire": "gpe"}
RECORDINGS = {"NwirePhantomFreehand": "N-wire", "SpinePhantomFreehand": "spine"}
OF_EACH = ("drift_mm", "drift_deg", "step_mm")
LEARNED, FLOORS = "pair-cnn", ("no-motion", "mean-motion")
TITLES = {
    "gpe": "GPE, mm", "gle": "GLE, mm", "lpe": "LPE, mm", "lle": "LLE, mm", "score": "score",
    "drift_mm": "drift, mm", "step_mm": "step, mm", "drift_deg": "drift, °",
    "step_deg": "step, °",
}  # fmt: skip
SHIFTS = (0.0, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4)
"""How far the probe is moved, mm; of 0, noise and blood alone are new."""
PATIENTS = 10
"""Validation patients whose nominal views are looked at."""
FINE = 5
"""Pixels a side of the mean that is taken off an image: what is left is speckle and edges."""
RIM, NEAR = 15, 32
"""Pixels that are left out along the sector's edges, which stand still, and rows near the face."""


def cell(metric: dict[str, Any] | None, digits: int) -> str:
    """Return a value with its interval."""
    if metric is None:
        return "–"
    value, low, high = (metric[key] for key in ("value", "low", "high"))
    if low is None or low == high:
        return f"{value:.{digits}f}"
    return f"{value:.{digits}f} ({low:.{digits}f} – {high:.{digits}f})"


def read(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the scores in a folder by the estimator's name."""
    scores = [json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))]
    return {each["motion"]: each for each in scores}


def table(name: str, found: dict[str, Any]) -> dict[str, Any]:
    """Return a table of scores, the smallest error first."""
    key, rows = RANKED[name], []
    ranked = sorted(found.items(), key=lambda each: each[1]["metrics"][key]["value"])
    for place, (title, scores) in enumerate(ranked, 1):
        told = [cell(scores["metrics"].get(each), 3 if each == "score" else 1)
                for each in SHOWN[name]]  # fmt: skip
        rows.append([str(place), title, str(scores["runs"]), *told])
    columns = ["", "estimator", "trainings", *(TITLES[each] for each in SHOWN[name])]
    return {"columns": columns, "rows": rows}


def by_recording(folder: Path, found: dict[str, Any]) -> dict[str, Any]:
    """Return the table of errors of each recording, means over trainings, the least drift first."""
    rows = []
    for name, scores in found.items():
        figures = Evidence.read(folder / f"{name}.parquet").figures
        own = {each.partition("-")[0]: item for item, each in scores["sweeps"].items()}
        values = []
        for recording in RECORDINGS:
            for key in OF_EACH:
                told = figures[key]
                assert told.values is not None and told.items is not None
                place = int(np.flatnonzero(told.items == int(own[recording]))[0])
                values.append(float(told.values[..., place].mean()))
        rows.append([name, str(scores["runs"]), *values])
    rows.sort(key=lambda row: row[2])
    columns = [f"{title}: {TITLES[key]}" for title in RECORDINGS.values() for key in OF_EACH]
    shown = [[*row[:2], *(f"{value:.1f}" for value in row[2:])] for row in rows]
    return {"columns": ["estimator", "trainings", *columns], "rows": shown}


def better(folder: Path) -> dict[str, Any]:
    """Return by how much the learned estimator is below each floor, on the same sweeps."""
    kept = {name: Evidence.read(folder / f"{name}.parquet").figures for name in (LEARNED, *FLOORS)}
    found: dict[str, Any] = {}
    for floor in FLOORS:
        for key in ("gpe", "lpe", "drift_mm"):
            told = difference(kept[floor][key].replicates(), kept[LEARNED][key].replicates())
            ends = {"value": told.value, "low": told.low, "high": told.high}
            found.setdefault(floor, {})[key] = {
                name: None if value is None else round(value, 2) for name, value in ends.items()
            }
    return found


def explained(found: dict[str, Any]) -> dict[str, Any]:
    """Return the table of the share of each of a step's six numbers that is estimated."""
    axes = list(next(iter(found.values()))["explained"])
    rows = [[name, *(f"{round(100 * scores['explained'][axis])} %" for axis in axes)]
            for name, scores in found.items()]  # fmt: skip
    return {"columns": ["estimator", *(axis.replace("_", " ") for axis in axes)], "rows": rows}


def likeness(pool: Pool, axis: int) -> Tensor:
    """Return (len(SHIFTS),) mean correlations of fine detail before and after a shift.

    Of the nominal views of all patients of a pool; the probe is shifted along one of its axes.
    """
    patients = torch.arange(len(pool))
    nominal = pool.targets(patients)
    rows = patients.repeat_interleave(len(pool.views))
    pose = Pose(nominal.position.flatten(0, 1), nominal.rotation.flatten(0, 1))
    step = torch.zeros(3)
    step[axis] = 1e-3
    way = rotate(pose.rotation, step.expand(len(rows), 3))
    seeds = torch.arange(len(rows))
    before = fine(pool.render(pose, rows, seeds=seeds))
    found = []
    for place, shift in enumerate(SHIFTS, 1):
        moved = Pose(pose.position + shift * way, pose.rotation)
        after = fine(pool.render(moved, rows, seeds=seeds + 1_000 * place))
        norms = before.norm(dim=1) * after.norm(dim=1)
        found.append(((before * after).sum(1) / norms).mean())
    return torch.stack(found)


def fine(images: Tensor) -> Tensor:
    """Return (B, 16384) of images: what a local mean leaves of the inside of the sector."""
    light = images.float().unsqueeze(1)
    inside = -max_pool2d(-(light > 0).float(), RIM, 1, RIM // 2)
    inside[:, :, :NEAR] = 0.0
    detail = light - avg_pool2d(light, FINE, 1, FINE // 2)
    return (detail * inside).flatten(1)


def forgetting() -> dict[str, Any]:
    """Return the table of likeness by shift, within the image plane and out of it."""
    pool = Pool(list(seeds_of("validation"))[:PATIENTS])
    sides = {"across the image": 0, "out of its plane": 1}
    rows = [[name, *(f"{value:.2f}" for value in likeness(pool, axis).tolist())]
            for name, axis in sides.items()]  # fmt: skip
    return {"columns": ["probe moved", *(f"{shift:g} mm" for shift in SHIFTS)], "rows": rows}


def fill(folder: Path) -> None:
    """Write the figures and tables."""
    found = {name: read(folder / place) for place, name in PLACES.items()}
    simulated = found["simulated"]
    first = next(iter(simulated.values()))
    figures: dict[str, Any] = {
        "sweeps": first["counts"]["sweeps"],
        "frames": first["counts"]["frames"],
        "patients": first["metrics"]["gpe"]["settings"]["units"],
        "step": round(simulated["no-motion"]["metrics"]["step_mm"]["value"], 1),
        "turn": round(simulated["no-motion"]["metrics"]["step_deg"]["value"], 1),
    }
    figures["better"] = better(folder)
    tables = {name: table(name, found[name]) for name in RANKED}
    tables |= {"tracked": by_recording(folder / "tracked", found["tracked"])}
    tables |= {"explained": explained(simulated), "forgetting": forgetting()}
    keep(figures, tables)


def fill_recorded(folder: Path) -> None:
    """Write the tables of recordings, of trainings that are scored on simulated sweeps as well."""
    tracked, nwire = folder / "tracked", folder / "nwire"
    tables = {"tracked": by_recording(tracked, read(tracked)), "nwire": table("nwire", read(nwire))}
    again = read(folder / "simulated")[LEARNED]["metrics"]["gpe"]
    keep({"gpe_again": {key: round(again[key], 1) for key in ("value", "low", "high")}}, tables)


def keep(figures: dict[str, Any], tables: dict[str, Any]) -> None:
    """Write figures and tables; what is there under other names stays."""
    content = json.loads(RESULT.read_text()) if RESULT.is_file() else {}
    parts = {"figures": figures, "tables": tables}
    write_json(RESULT, content | {key: content.get(key, {}) | each for key, each in parts.items()})


if __name__ == "__main__":
    (fill_recorded if sys.argv[2:] == ["recorded"] else fill)(Path(sys.argv[1]))
