"""In how many patients some view is shown at no pose that was found, by pathology.

python -m tests.data.patients.shown docs/results/patients-shown.json

A view counts as shown where the task would call it found: p of at least 0.9 and a grade of at least
5 at the nominal pose, over the beat where hearts beat.
"""

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch

from racines_data.files import write_json
from racines_data.geometry import Pose
from racines_data.patients.patient import PATHOLOGIES, PATIENTS_VERSION
from racines_data.patients.pool import Pool
from racines_data.patients.population import draw_patient
from racines_data.patients.splits import seeds_of
from racines_envs.worlds.ward import BEAT, over_beat

EACH = 120
"""Patients of a pathology."""
AT_ONCE = 20


def first(each: int) -> dict[str, list[int]]:
    """Return the first train patients of each pathology."""
    found: dict[str, list[int]] = {name: [] for name in PATHOLOGIES}
    for seed in seeds_of("train"):
        own = found[draw_patient(seed).pathology]
        if len(own) < each:
            own.append(seed)
        if all(len(seeds) == each for seeds in found.values()):
            break
    return found


def lacking(seeds: list[int], beating: bool) -> Iterator[tuple[int, list[str]]]:
    """Yield patients who lack a view, and which."""
    for start in range(0, len(seeds), AT_ONCE):
        pool = Pool(seeds[start : start + AT_ONCE], beating=beating)
        views = len(pool.views)
        rows = torch.arange(len(pool)).repeat_interleave(views)
        goal = torch.arange(views).repeat(len(pool))
        nominal = pool.targets(torch.arange(len(pool)))
        pose = Pose(*(part.flatten(0, 1) for part in nominal))
        truth = over_beat(pool.judge_beat(pose, rows, BEAT)) if beating else pool.judge(pose, rows)
        p, grade = (part.gather(1, goal.unsqueeze(1)).squeeze(1)
                    for part in (truth.membership, truth.view_grade))  # fmt: skip
        shown = ((p >= 0.9) & (grade >= 5.0)).view(len(pool), views)
        for seed, own in zip(pool.seeds, shown.tolist(), strict=True):
            if not all(own):
                yield seed, [view for view, seen in zip(pool.views, own, strict=True) if not seen]


def count(each: int = EACH) -> dict[str, Any]:
    """Return, of still and beating hearts, who lacks which view, by pathology."""
    seeds = first(each)
    return {
        kind: {name: dict(lacking(own, kind == "beating")) for name, own in seeds.items()}
        for kind in ("still", "beating")
    }


def result(found: dict[str, Any], each: int) -> dict[str, Any]:
    """Return what the documentation shows."""
    rows, most = [], 0.0
    for name in PATHOLOGIES:
        cells = []
        for kind in ("still", "beating"):
            lack = found[kind][name]
            most = max(most, 100.0 * len(lack) / each)
            views = sorted({view for own in lack.values() for view in own})
            cells.append(f"{len(lack)} of {each}" + (f" ({', '.join(views)})" if views else ""))
        rows.append([name, *cells])
    columns = ["pathology", "still", "beating"]
    return {
        "schema": "racines.figures/1",
        "what": f"patients of whom a view is shown at no pose found, world {PATIENTS_VERSION}",
        "command": "python -m tests.data.patients.shown docs/results/patients-shown.json",
        "machine": "AMD EPYC, one thread, beside other work",
        "source": "measured once",
        "figures": {"each": each, "most": round(most, 2)},
        "tables": {"unshown": {"columns": columns, "rows": rows}},
    }


if __name__ == "__main__":
    each = int(os.environ.get("EACH", EACH))
    torch.set_num_threads(1)
    write_json(Path(sys.argv[1]), result(count(each), each))
