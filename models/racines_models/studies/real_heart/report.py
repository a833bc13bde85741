"""One real heart's measures beside a population's: inside its spread, or how far outside.

A population is a JSON list with a mapping a patient: `patient`, `pathology`, and any of the
measures of `measures.UNITS` by name. Whoever simulates patients writes it.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from racines_data.errors import RacinesError
from racines_data.plotting import BLUE, INK, OURS, PAPER, VERMILION, card_style, encode
from racines_models.provenance import code_version
from racines_models.studies.real_heart.measures import UNITS, Phase, heart_measures, phase_table

SCHEMA = "racines.real-heart/1"
ALL = "all"


def read_population(path: Path) -> list[dict[str, Any]]:
    """Read a population's table.

    Raises:
        RacinesError: absent, no JSON list of mappings, or none of the measures, or one that is no
            number; by patient and name.
    """
    if not path.is_file():
        raise RacinesError(
            f"{path}: no such file; name a population's measures (docs/sim-to-real.md)"
        )
    try:
        patients = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise RacinesError(f"{path}: not valid JSON: {error}; write it again") from error
    patients = patients.get("patients") if isinstance(patients, dict) else patients
    if not isinstance(patients, list) or not all(isinstance(each, dict) for each in patients):
        raise RacinesError(f"{path}: no list of patients; give one mapping a patient")
    if not any(name in each for each in patients for name in UNITS):
        raise RacinesError(f"{path}: no patient has one of {', '.join(UNITS)}; name them so")
    for number, each in enumerate(patients):
        for name in set(UNITS) & set(each):
            if not isinstance(each[name], int | float):
                who = each.get("patient", number)
                raise RacinesError(
                    f"{path}: patient {who}: {name} is {each[name]!r}; give a number"
                )
    return patients


def spread(patients: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return by pathology, and for all, mean, SD and range of each measure that patients have."""
    groups: dict[str, list[Mapping[str, Any]]] = {ALL: list(patients)}
    for each in patients:
        if "pathology" in each:
            groups.setdefault(str(each["pathology"]), []).append(each)
    return {
        name: {
            measure: _described(np.array(values, float))
            for measure in UNITS
            if (values := [each[measure] for each in group if measure in each])
        }
        for name, group in groups.items()
    }


def _described(values: np.ndarray) -> dict[str, Any]:
    deviation = float(values.std(ddof=1)) if len(values) > 1 else None
    ends = {"low": float(values.min()), "high": float(values.max())}
    return {"n": len(values), "mean": float(values.mean()), "sd": deviation} | ends


def compare(
    phases: list[Phase], patients: Sequence[Mapping[str, Any]] | None = None
) -> dict[str, Any]:
    """Return the report: the heart's phases and measures, and where a population has them."""
    measures = heart_measures(phases)
    rows: dict[str, Any] = {}
    populations = spread(patients) if patients else {}
    for name, value in measures.items():
        rows[name] = {"value": round(value, 3), "unit": UNITS[name]}
        if found := populations.get(ALL, {}).get(name):
            rows[name]["inside"] = bool(found["low"] <= value <= found["high"])
            if found["sd"]:
                rows[name]["deviations"] = round((value - found["mean"]) / found["sd"], 2)
    return {
        "schema": SCHEMA,
        "hearts": 1,
        "measures": rows,
        "phases": phase_table(phases),
        "population": populations,
        "code": code_version(),
    }


def draw(content: dict[str, Any]) -> bytes:
    """Return a PNG of volumes, length and thickness over the beat, and of the measures' places."""
    phases, populations = content["phases"], content["population"]
    with card_style():
        figure = Figure(figsize=(12.6 if populations else 9.4, 3.3), layout="constrained")
        panels = figure.subplots(1, 4 if populations else 3)
        at = [each["phase"] for each in phases]
        for axes, names, unit in (
            (panels[0], ("lv", "rv", "muscle"), "mL"),
            (panels[1], ("length", "diameter"), "mm"),
            (panels[2], ("septum", "wall"), "mm"),
        ):
            for name, colour in zip(names, (BLUE, VERMILION, INK), strict=False):
                axes.plot(at, [each[name] for each in phases], color=colour, label=name)
            axes.set(ylim=(0, None), xlabel="phase, by its number", ylabel=unit)
            axes.legend()
        if populations:
            _places(panels[3], content["measures"], populations[ALL])
        return encode(figure)


def _places(axes: Any, measures: dict[str, Any], everyone: dict[str, Any]) -> None:
    told = {name: row["deviations"] for name, row in measures.items() if "deviations" in row}
    place = np.arange(len(told))[::-1]
    axes.axvspan(-2, 2, color=OURS, alpha=0.15, linewidth=0)
    axes.plot(list(told.values()), place, "o", color=PAPER, markersize=4)
    axes.set_yticks(place, list(told))
    n = max(each["n"] for each in everyone.values())
    axes.set(xlabel="from the population's mean, SD", title=f"one real heart, {n} patients")
