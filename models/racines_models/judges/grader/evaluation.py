"""What stands beside a grader's weights: its metrics and their plots."""

import json
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.files import write_json
from racines_data.store.frames import FrameStore
from racines_models.judges.grader.calibration import calibrate
from racines_models.judges.grader.model import CONFIG, Grader, read_config
from racines_models.judges.grader.plots import write_plots
from racines_models.judges.grader.report import examine
from racines_models.provenance import code_version, dataset_card

METRICS = "metrics.json"
SCHEMA = "racines.grader-metrics/1"


def write_report(
    folder: Path, grader: Grader, store: FrameStore, split: str = "test", **more: Any
) -> dict[str, Any]:
    """Examine a grader on a split and write `metrics.json` and the plots into `folder`.

    Keys that `metrics.json` has already and that the report does not make, such as what the
    training took, are kept; `more` is added.
    """
    examined = examine(grader, store, split)
    path = folder / METRICS
    before = json.loads(path.read_text()) if path.is_file() else {}
    metrics = before | {"schema": SCHEMA} | examined.content | more
    metrics["plots"] = write_plots(folder, examined)
    write_json(path, metrics)
    return metrics


def evaluate_grader(
    folder: Path, store: FrameStore, split: str, out: Path, recalibrate: bool, device: str
) -> dict[str, Any]:
    """Report a saved grader on a split into `out`; with `recalibrate`, fit its temperature first.

    Raises:
        RacinesError: no grader in `folder`, one of other views, or a split without frames.
    """
    grader = Grader.load(folder, device)
    if not len(store.split_indices(split)):
        raise RacinesError(f"split {split}: no frames; choose another with --split")
    made = {"evaluated": {"dataset": dataset_card(store), "code": code_version()}}
    if recalibrate:
        frames = calibrate(grader, store)
        fitted = {"split": "validation", "frames": frames, "dataset": dataset_card(store)}
        described = read_config(folder) | {"temperature": grader.temperature, "calibrated": fitted}
        write_json(folder / CONFIG, described)
    return write_report(out, grader, store, split, sha256=grader.sha256, **made)
