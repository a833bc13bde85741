"""The figures of docs/downstream.md, of a study that was run.

racines study downstream --profile reference --workers 2
python -m tests.envs.studies.downstream envs/runs/downstream
"""

import json
import shlex
import sys
from pathlib import Path
from typing import Any

from racines_data.files import write_atomic, write_json
from racines_envs.studies.downstream import figures
from racines_envs.studies.downstream.correlation import PRIMARY

ROOT = Path(__file__).parents[3]
RESULT = ROOT / "docs/results/downstream.json"
PICTURE = ROOT / "docs/images/downstream.png"
TABLES = {"correlations": PRIMARY[1], "grades": "final_grade"}


def main(folder: Path) -> None:
    """Write the result file, and draw the picture."""
    study = json.loads((folder / "downstream.json").read_text())
    settings, rows = study["settings"], study["points"]
    told: dict[str, Any] = {
        name: settings[name] for name in ("patients", "images", "judged", "starts")
    }
    told |= {"frames": settings["lessons"]["frames"], "places": settings["lessons"]["places"]}
    told |= {"views": " and ".join(settings["views"]), "count": len(rows)}
    told["generators"] = sum(row["kind"] != "truth" for row in rows)
    told["hours"] = round(sum(row["seconds"] for row in rows) / 3600, 1)
    named = " ".join(shlex.quote(each) for each in settings["points"])
    command = f"racines study downstream {named} --profile reference --workers 2"
    every = {
        name: {
            "columns": ["metric", *figures.groups_of(study)],
            "rows": [list(row) for row in figures.correlation_rows(study, outcome)],
        }
        for name, outcome in TABLES.items()
    }
    points = {
        "columns": list(figures.heads()),
        "rows": [list(row) for row in figures.point_rows(study)],
    }
    write_json(
        RESULT,
        {
            "schema": "racines.figures/1",
            "what": "servos that learned from generators' images, beside the images' metrics",
            "command": command,
            "machine": f"two cores of a shared {study['environment']['cpu']}",
            "source": "measured once",
            "figures": told,
            "tables": {"points": points, **every},
        },
    )
    write_atomic(PICTURE, figures.draw_downstream(study))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
