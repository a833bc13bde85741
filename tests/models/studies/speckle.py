"""What the documentation says of drawn speckle: the scores of settings on validation patients.

racines eval generator NAME --tier patients --split validation --patients 12 --run RUN --out FOLDER
python -m tests.models.studies.speckle MACHINE LABEL=FOLDER/NAME.json …
"""

import json
import sys
from pathlib import Path
from typing import Any

import yaml

from racines_data.files import write_json
from tests.models.studies.adapted import METRICS
from tests.models.studies.judged import number

OUT = Path(__file__).parents[3] / "docs/results/speckle.json"
SHOWN = ("ssim", "psnr", "kid", "fid", "dice")


def main(machine: str, given: list[str]) -> None:
    """Write the table, a row a setting, in the order given."""
    found = {}
    for each in given:
        label, _, path = each.rpartition("=")
        found[label] = json.loads(Path(path).read_text(encoding="utf-8"))
    asked = {scores["dataset"]["sample"] for scores in found.values()}
    assert len(asked) == 1, "scores of unlike poses"
    first = next(iter(found.values()))
    assert first["dataset"]["split"] == "validation", first["dataset"]
    told = first["metrics"]["ssim"]
    rows = [
        [label, str(scores["runs"]), *(number(scores["metrics"][key], METRICS[key][1])
                                       for key in SHOWN)]
        for label, scores in found.items()
    ]  # fmt: skip
    write_json(OUT, {
        "schema": "racines.figures/1",
        "what": "speckle that is drawn: settings of generators that adapt, on validation patients",
        "command": "racines eval generator NAME --tier patients --split validation --patients 12 "
        "--run RUN --out FOLDER; python -m tests.models.studies.speckle MACHINE LABEL=FILE …",
        "machine": machine,
        "source": "measured once",
        "figures": {"patients": told["settings"]["units"], "poses": told["n"]} | _of_fitting(found),
        "tables": {
            "settings": {
                "columns": ["images", "trainings", *(METRICS[key][0] for key in SHOWN)],
                "rows": rows,
            }
        },
    })  # fmt: skip


def _of_fitting(found: dict[str, Any]) -> dict[str, Any]:
    """Return what the steps of fitting add to SSIM of a field, and its score by its grain."""
    plain, fitted = (
        found[label]["metrics"]["ssim"]["value"]
        for label in ("`scout-field`, not fitted", "`scout-field`")
    )
    scores = {
        name: round(_score(found[label]["metrics"]), 3)
        for name, label in (("0", "`scout-field`"), ("0_2", "`scout-field`, grain 0.2"),
                            ("0_35", "`scout-field`, grain 0.35"))
    }  # fmt: skip
    return {"gain": {"ssim": round(fitted - plain, 4)}, "score": scores}


def _score(metrics: dict[str, Any]) -> float:
    """Return the board's score, by the anchors that the profile `reference` names."""
    told = yaml.safe_load((OUT.parents[2] / "racines_data/profiles/reference.yaml").read_text())
    anchors = told["downstream"]["anchors"]
    shares = [
        (metrics[name]["value"] - worst) / (best - worst) for name, (worst, best) in anchors.items()
    ]
    return sum(shares) / len(shares)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
