"""What simulated patients measure, by sex and pathology, beside what healthy people measure.

Measures are counted in the simulated geometry (`racines_data.patients.measures`), not read from the
numbers that drew it.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from racines_data.errors import RacinesError
from racines_data.manifest import check_split
from racines_data.patients.heart import make_heart
from racines_data.patients.measures import Measures, measure
from racines_data.patients.patient import PATHOLOGIES, PATIENTS_VERSION
from racines_data.patients.population import draw_patient
from racines_data.patients.splits import seeds_of
from racines_data.plotting import OURS, PAPER, card_style, encode
from racines_models.provenance import code_version

SCHEMA = "racines.population/1"
SEXES = ("women", "men")
UNITS = {
    "lv_diameter_ed": "mm", "lv_diameter_es": "mm", "lv_length_ed": "mm", "lv_shortening": "mm",
    "septum_ed": "mm", "wall_ed": "mm", "septum_thickening": "%", "wall_thickening": "%",
    "lv_edv": "mL", "lv_esv": "mL", "lv_ef": "%", "rv_edv": "mL", "rv_esv": "mL", "rv_ef": "%",
    "left_atrium": "mm", "la_volume": "mL", "right": "mm", "root": "mm",
}  # fmt: skip
"""Measures and their units, by the names that `study real-heart` knows, too."""
TITLES = {
    "lv_diameter_ed": "LV across, end diastole", "lv_diameter_es": "LV across, end systole",
    "lv_length_ed": "LV length", "lv_shortening": "descent of the base", "septum_ed": "septum",
    "wall_ed": "posterior wall", "septum_thickening": "septum thickens",
    "wall_thickening": "posterior wall thickens", "lv_edv": "LV volume, end diastole",
    "lv_esv": "LV volume, end systole", "lv_ef": "LV ejection fraction",
    "rv_edv": "RV volume, end diastole", "rv_esv": "RV volume, end systole",
    "rv_ef": "RV ejection fraction", "left_atrium": "LA, front to back",
    "la_volume": "LA volume, greatest", "right": "RV across the base", "root": "aortic root",
}  # fmt: skip
"""Measures as people read them."""
NORMS: dict[str, dict[str, tuple[float, float]]] = {
    "lv_diameter_ed": {"women": (45.0, 3.6), "men": (50.2, 4.1)},
    "lv_diameter_es": {"women": (28.2, 3.3), "men": (32.4, 3.7)},
    "lv_edv": {"women": (76.0, 15.0), "men": (106.0, 22.0)},
    "lv_esv": {"women": (28.0, 7.0), "men": (41.0, 10.0)},
    "lv_ef": {"women": (64.0, 5.0), "men": (62.0, 5.0)},
    "rv_ef": {"women": (58.0, 6.5), "men": (58.0, 6.5)},
    "right": {"women": (33.0, 4.0), "men": (33.0, 4.0)},
    "root": {"women": (30.0, 3.0), "men": (34.0, 3.0)},
}
"""Mean and SD of healthy adults by echocardiography (Lang et al., JASE 2015; 28: 1-39)."""
RANGES: dict[str, dict[str, tuple[float, float]]] = {
    "septum_ed": {"women": (6.0, 9.0), "men": (6.0, 10.0)},
    "wall_ed": {"women": (6.0, 9.0), "men": (6.0, 10.0)},
    "left_atrium": {"women": (27.0, 38.0), "men": (30.0, 40.0)},
}
"""Normal ranges, where the same source tells no mean."""


def survey(
    split: str, patients: int, progress: Callable[[int], None] | None = None
) -> dict[str, Any]:
    """Measure the first patients of a split; a second each.

    Returns:
        As `content`: `patients`, a mapping each with `patient`, `pathology`, `sex` and measures;
        `groups`: of healthy women and men, of each pathology, and of its women and men, `n` and by
        measure mean, SD and range; `norms`, and `ranges` where only they are known.

    Raises:
        RacinesError: an unknown split, or more patients than it has.
    """
    known = seeds_of(check_split(split))
    if patients > len(known):
        raise RacinesError(f"{patients} patients: split {split!r} has 1 to {len(known)}")
    rows: list[dict[str, Any]] = []
    for done, seed in enumerate(known[:patients], 1):
        patient = draw_patient(seed)
        told = measures_of(measure(make_heart(patient, beating=False)))
        sex = SEXES[0] if patient.body.female else SEXES[1]
        rows.append({"patient": seed, "pathology": patient.pathology, "sex": sex, **told})
        if progress is not None:
            progress(done)
    return {
        "schema": SCHEMA,
        "world": {"name": "patients", "version": PATIENTS_VERSION, "split": split},
        "code": code_version(),
        "units": UNITS,
        "norms": NORMS,
        "ranges": RANGES,
        "groups": groups_of(rows),
        "patients": rows,
    }


def measures_of(found: Measures) -> dict[str, float]:
    """Return the measures of a heart by name."""
    lv, rv, la = (found.volumes[name] for name in ("lv", "rv", "la"))
    (septum, septum_es), (wall, wall_es) = found.septum, found.wall
    values = {
        "lv_diameter_ed": found.lv_diameter[0], "lv_diameter_es": found.lv_diameter[1],
        "lv_length_ed": found.lv_length[0], "lv_shortening": found.shortening,
        "septum_ed": septum, "wall_ed": wall,
        "septum_thickening": 100.0 * (septum_es / septum - 1.0),
        "wall_thickening": 100.0 * (wall_es / wall - 1.0),
        "lv_edv": lv[0], "lv_esv": lv[-1], "lv_ef": 100.0 * found.ejection_fraction,
        "rv_edv": rv[0], "rv_esv": rv[-1], "rv_ef": 100.0 * found.right_ejection_fraction,
        "left_atrium": found.left_atrium, "la_volume": max(la),
        "right": found.right, "root": found.root,
    }  # fmt: skip
    return {name: round(value, 3) for name, value in values.items()}


def groups_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return what groups of patients measure; a group of nobody is left out."""
    healthy = PATHOLOGIES[0]
    groups = {
        sex: [r for r in rows if r["pathology"] == healthy and r["sex"] == sex] for sex in SEXES
    }
    for name in PATHOLOGIES[1:]:
        groups[name] = [row for row in rows if row["pathology"] == name]
        groups |= {f"{name}, {sex}": [r for r in groups[name] if r["sex"] == sex] for sex in SEXES}
    return {
        name: {"n": len(group)} | {each: _described([row[each] for row in group]) for each in UNITS}
        for name, group in groups.items()
        if group
    }


def _described(values: Sequence[float]) -> dict[str, float | None]:
    found = np.array(values, float)
    deviation = float(found.std(ddof=1)) if len(found) > 1 else None
    return {"mean": float(found.mean()), "sd": deviation, "low": found.min(), "high": found.max()}


Table = tuple[tuple[str, ...], list[tuple[str, ...]]]


def tables_of(content: Mapping[str, Any]) -> list[Table]:
    """Return head and rows of a report's tables: the healthy and norms, pathologies, and by sex."""
    groups = content["groups"]
    healthy, others = SEXES, PATHOLOGIES[1:]
    by_sex = [[f"{name}, {sex}" for name in others] for sex in SEXES]
    kinds = [[name for name in names if name in groups] for names in (healthy, others, *by_sex)]
    return [_table_of(content, names) for names in kinds if names]


def _table_of(content: Mapping[str, Any], names: Sequence[str]) -> Table:
    groups = {name: content["groups"][name] for name in names}
    head, rows = ["measure"], []
    for name, group in groups.items():
        head.append(f"{name}, n = {group['n']}")
        if name in SEXES:
            head.append(f"{name}, norm")
    for measure_name, unit in content["units"].items():
        cells = [f"{TITLES[measure_name]}, {unit}"]
        for name, group in groups.items():
            each = group[measure_name]
            told = _told(each["mean"], each["sd"])
            cells.append(f"{told}\n{each['low']:.0f} to {each['high']:.0f}")
            if name in SEXES:
                cells.append(_norm(content, measure_name, name))
        rows.append(tuple(cells))
    return tuple(head), rows


def _norm(content: Mapping[str, Any], measure_name: str, sex: str) -> str:
    if norm := content["norms"].get(measure_name, {}).get(sex):
        return _told(*norm)
    known = content.get("ranges", {}).get(measure_name, {}).get(sex)
    return f"{known[0]:.0f} to {known[1]:.0f}" if known else "–"


def _told(mean: float, deviation: float | None) -> str:
    return f"{mean:.1f}" if deviation is None else f"{mean:.1f} ± {deviation:.1f}"


def draw(content: Mapping[str, Any]) -> bytes:
    """Return a PNG: each patient by group, on what healthy women and men measure, mean ± 2 SD."""
    rows = content["patients"]
    shown = (*SEXES, *PATHOLOGIES[1:])
    groups = {name: group for name, group in content["groups"].items() if name in shown}
    with card_style():
        figure = Figure(figsize=(12.0, 5.6), layout="constrained")
        for axes, (name, norms) in zip(figure.subplots(2, 4).flat, NORMS.items(), strict=True):
            for place, group in enumerate(groups):
                values = np.sort([row[name] for row in rows if _is_of(row, group)])
                # Spread by rank, so that the picture is the same each time.
                aside = np.modf(np.arange(len(values)) * 0.618)[0] - 0.5
                axes.plot(place + 0.5 * aside, values, "o", color=OURS, markersize=2.5, alpha=0.6)
                if group in norms:
                    mean, deviation = norms[group]
                    axes.fill_between(
                        [place - 0.4, place + 0.4], mean - 2 * deviation, mean + 2 * deviation,
                        color=PAPER, alpha=0.25, linewidth=0,
                    )  # fmt: skip
            told = [f"{group}, n = {found['n']}" for group, found in groups.items()]
            axes.set_xticks(range(len(groups)), told, rotation=35, ha="right")
            axes.set(title=TITLES[name], ylabel=UNITS[name])
        figure.suptitle(
            "simulated patients; shaded: healthy women and men, mean ± 2 SD (Lang 2015)"
        )
        return encode(figure)


def _is_of(row: Mapping[str, Any], group: str) -> bool:
    if group in SEXES:
        return row["sex"] == group and row["pathology"] == PATHOLOGIES[0]
    return row["pathology"] == group
