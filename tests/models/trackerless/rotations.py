"""What docs/trackerless.md says of turns about an apex: the floors, and how the probe turned.

For each SPLIT (interpolation, gap), with sets in FOLDER/SPLIT and scores in FOLDER/scores/SPLIT:

racines data import ECHO --source rotation --set split=SPLIT --out FOLDER/SPLIT
racines train motion mean-motion --data FOLDER/SPLIT --config frames --out FOLDER/mean/SPLIT
racines eval motion no-motion --data FOLDER/SPLIT --config frames --out FOLDER/scores/SPLIT
racines eval motion no-motion --data FOLDER/gap --config frames --split all --out FOLDER/scores/all
python -m tests.models.trackerless.rotations FOLDER

and likewise of constant-motion, and of mean-motion with --run FOLDER/mean/SPLIT without `all`.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from racines_data.files import write_atomic, write_json
from racines_data.plotting import BLUE, GREEN, INK, MUTED, VERMILION, card_style, encode, evenly
from racines_data.store.frames import open_store
from racines_models.trackerless.floors import ConstantMotion, MeanMotion, NoMotion
from racines_models.trackerless.motion import Motion, to_vectors
from racines_models.trackerless.sweeps import EVERY, SweepSet

DOCS = Path(__file__).parents[3] / "docs"
RESULT, PICTURE = (
    DOCS / "results/trackerless-rotation.json",
    DOCS / "images/trackerless-rotation.png",
)
FLOORS = ("no-motion", "constant-motion", "mean-motion")
SETS = {EVERY: "all turns", "interpolation": "interpolation", "gap": "gap"}
"""Folders of scores, and what the columns say of them."""
SHOWN = 7
"""Frames in the picture."""
COMMAND = (
    "racines data import neuralcmf --source rotation --set split=SPLIT --out SPLIT; racines train "
    "motion mean-motion --data SPLIT --config frames; racines eval motion NAME --data SPLIT "
    "--config frames (and --split all of no-motion and constant-motion); "
    "python -m tests.models.trackerless.rotations FOLDER"
)


def read(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the scores in a folder by the estimator's name."""
    return {path.stem: json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))}


def table(found: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the angles by which each floor is off, degrees."""
    columns = ["estimator", *(f"{title}: {kind}, °" for title in SETS.values()
                              for kind in ("step", "drift"))]  # fmt: skip
    rows = []
    for name in FLOORS:
        told = [found[place].get(name, {}).get("metrics", {}) for place in SETS]
        rows.append([name, *(f"{each[key]['value']:.1f}" if each else "–" for each in told
                             for key in ("step_deg", "drift_deg"))])  # fmt: skip
    return {"columns": columns, "right": 1, "rows": rows}


def about_the_beam(motion: Motion) -> np.ndarray:
    """Return (T,) how far the probe has turned about its beam since the first frame, degrees."""
    return np.degrees(np.unwrap(to_vectors(motion.to_first)[:, 5].numpy()))


def draw(axes: Axes, sweeps: SweepSet, split: str, floors: dict[str, Any], title: str) -> None:
    """Draw the true turn of a split's first sweep, and what the floors say of it."""
    sweep = sweeps.sweeps(split)[0]
    true = about_the_beam(sweep.motion)
    axes.plot(true, color=INK, linewidth=1.2, label="true")
    for (name, floor), shade in zip(floors.items(), (MUTED, VERMILION, BLUE), strict=False):
        told = floor.estimate(sweeps.shown(sweep, told_first=floor.told_first))
        axes.plot(about_the_beam(told), "--", color=shade, linewidth=1.0, label=name)
    axes.set_ylim(true.min() - 40, true.max() + 40)
    axes.set(title=title, xlabel="turn, in the order of the file")
    axes.set_ylabel("turned about the beam, °")


def picture(folder: Path) -> bytes:
    """Return frames of one phase along the file, and the turn along it by the floors."""
    sweeps = SweepSet(open_store(folder / "interpolation"))
    whole = sweeps.sweeps(EVERY)[0]
    at = evenly(len(whole), SHOWN)
    images = sweeps.shown(whole).images
    with card_style():
        figure = Figure(figsize=(9.0, 4.6), layout="constrained", dpi=130)
        rows: Any = figure.subfigures(2, 1, height_ratios=(1.0, 1.9))
        above, below = rows
        for axes, row in zip(above.subplots(1, SHOWN), at, strict=True):
            axes.imshow(images[row], cmap="gray", vmin=0, vmax=255)
            axes.set_title(f"turn {row}")
            axes.set_axis_off()
        floors: dict[str, Any] = {"no-motion": NoMotion(), "constant-motion": ConstantMotion()}
        left, right = below.subplots(1, 2)
        draw(left, sweeps, EVERY, floors, f"all {len(whole)} turns")
        left.plot(at, np.full(SHOWN, left.get_ylim()[0]), "^", color=GREEN, clip_on=False)
        floors["mean-motion"] = MeanMotion.load(folder / "mean/interpolation")
        many = len(sweeps.sweeps("test")[0])
        draw(right, sweeps, "test", floors, f"{many} turns held out, interpolation")
        right.legend(loc="lower left")
        return encode(figure)


def main(folder: Path) -> None:
    """Write the figures, the table and the picture."""
    found = {place: read(folder / "scores" / place) for place in SETS}
    sweeps = SweepSet(open_store(folder / "interpolation"))
    whole = sweeps.sweeps(EVERY)
    steps = to_vectors(whole[0].motion.to_previous[1:])[:, 3:].norm(dim=1).rad2deg()
    figures: dict[str, Any] = {
        "turns": len(whole[0]),
        "phases": len(whole),
        "median_step": round(float(steps.median()), 1),
        "greatest_step": round(float(steps.max())),
    }
    for place in ("interpolation", "gap"):
        told = found[place]["no-motion"]["counts"]
        figures[f"{place}_turns"] = told["frames"] // told["sweeps"]
    first = to_vectors(SweepSet(open_store(folder / "gap")).sweeps("test")[0].motion.to_previous[1])
    figures["gap_first_step"] = round(float(torch.rad2deg(first[3:].norm())))
    write_json(RESULT, {
        "schema": "racines.figures/1",
        "what": "motion of a probe that turned about the apex of one real heart: floors, in angles",
        "command": COMMAND,
        "machine": "one core of an AMD EPYC (Zen 4), beside other work",
        "source": "measured once",
        "figures": figures,
        "tables": {"floors": table(found)},
    })  # fmt: skip
    write_atomic(PICTURE, picture(folder))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
