"""What the documentation says of how real patients look, from the reports of the study.

racines study realism --world patients --real FILE --patients tuning --frames 62 --out TUNING
racines study realism --world patients --real FILE --patients reporting --frames 62 --out REPORTING
python -m tests.data.patients.realism TUNING REPORTING
"""

import json
import sys
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from racines_data.files import write_json
from racines_data.plotting import card_style, encode

DOCS = Path(__file__).parents[3] / "docs"
RESULT, CHART = DOCS / "results/patients-realism.json", DOCS / "assets/patients-realism.png"
LISTS, WORLDS = ("tuning", "reporting"), ("patients", "beating")
ROWS = {
    "kid": ("KID, Inception pool3", 3),
    "fid": ("FID, Inception pool3, n = {n}", 0),
    "gray": ("gray histogram, Wasserstein, gray levels", 1),
    "gray_by_cell": ("the same in 3 × 3 cells", 1),
    "gray_by_depth": ("mean gray by depth, r.m.s., gray levels", 1),
    "local_contrast": ("local contrast (5 × 5), Wasserstein", 2),
}
"""Figures, what the table calls them, and their decimals."""
Reports = dict[str, dict[str, dict[str, Any]]]


def read(tuning: str, reporting: str) -> Reports:
    """Return the reports by world and list."""
    places = dict(zip(LISTS, (tuning, reporting), strict=True))
    found = {
        world: {name: json.loads(Path(f"{out}-{world}.json").read_text(encoding="utf-8"))
                for name, out in places.items()}
        for world in WORLDS
    }  # fmt: skip
    for world in WORLDS:
        for name in LISTS:
            own = found[world][name]
            assert (own["config"], own["real"]["list"]) == (world, name), (world, name)
    return found


def row(reports: dict[str, dict[str, Any]], figure: str) -> list[str]:
    """Return a row of a table: both lists, then real beside real."""
    title, digits = ROWS[figure]

    def told(name: str, side: str) -> str:
        found = reports[name]["figures"][figure][side]
        value, low, high = (f"{found[key]:.{digits}f}" for key in ("value", "low", "high"))
        return f"{value} ({low} – {high})"

    cells = [told(name, side) for side in ("phantom", "real") for name in LISTS]
    return [title.format(n=reports["tuning"]["n"]), *cells]


def ratio(report: dict[str, Any], figure: str) -> float:
    """Return how many times as far from real frames patients are as real ones."""
    found = report["figures"][figure]
    return round(found["phantom"]["value"] / found["real"]["value"], 2)


def fill(reports: Reports) -> None:
    """Write the figures and tables; the column of the phantom and what was before stay."""
    kept = json.loads(RESULT.read_text())
    figures = kept["figures"]
    figures["kid"] = {
        world: {name: round(own[name]["figures"]["kid"]["phantom"]["value"], 4) for name in LISTS}
        for world, own in reports.items()
    }
    figures["ratio"] = {
        world: {name: {each: ratio(own[name], each) for each in ("gray_by_depth", "local_contrast")}
                for name in LISTS}
        for world, own in reports.items()
    }  # fmt: skip
    for world, own in reports.items():
        table = kept["tables"][world]
        beyond = {old[0]: old[5:] for old in table["rows"]}
        rows = [row(own, figure) for figure in ROWS]
        table["rows"] = [[*each, *beyond.get(each[0], [])] for each in rows]
    world = {name: own["tuning"]["world"] for name, own in reports.items()}
    write_json(RESULT, kept | {"world": world, "n": reports["patients"]["tuning"]["n"]})


def draw(reports: Reports) -> None:
    """Draw mean gray by depth of patients and of real frames, a panel a list."""
    with card_style():
        CHART.write_bytes(encode(_chart(reports)))


def _chart(reports: Reports) -> Figure:
    figure, panels = plt.subplots(1, 2, figsize=(10, 3.6), sharey=True, layout="constrained")
    for panel, name in zip(panels, LISTS, strict=True):
        sides = {
            "patients, still": (reports["patients"][name]["gray"]["phantom"], "C0-"),
            "patients, beating": (reports["beating"][name]["gray"]["phantom"], "C1--"),
            "real": (reports["patients"][name]["gray"]["real"], "k-"),
        }
        for label, (gray, style) in sides.items():
            depth = (np.arange(len(gray["by_depth"])) + 0.5) / len(gray["by_depth"])
            panel.plot(depth, gray["by_depth"], style, label=label)
        panel.set(title=f"{name} list", xlabel="depth, share of the sector", ylim=(0, 160))
    panels[0].set_ylabel("mean gray")
    panels[0].legend(frameon=False, fontsize="small")
    return figure


if __name__ == "__main__":
    found = read(*sys.argv[1:3])
    fill(found)
    draw(found)
