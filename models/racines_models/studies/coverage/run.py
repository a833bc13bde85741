"""The coverage study: its studies, kept as they come, and the report on them."""

import hashlib
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from racines_data.errors import RacinesError
from racines_data.files import write_atomic
from racines_models.provenance import code_version, environment, sha256_bytes
from racines_models.sample import Progress
from racines_models.statistics.intervals import (
    LEVEL,
    difference,
    interval,
    mean_replicates,
    median_interval,
    rate_interval,
    wilson_ends,
)
from racines_models.studies.coverage.population import Population
from racines_models.studies.coverage.simulation import (
    ITEMS,
    RANKED,
    SETS,
    Anchors,
    CoverageConfig,
    Simulation,
)

SCHEMA = "racines.coverage/1"
CHUNK = 50
"""Studies between two writings of what is there."""
ROWS = {
    "what": pl.String,
    "kind": pl.String,
    "units": pl.Int32,
    "trainings": pl.Int32,
    "study": pl.Int32,
    "value": pl.Float64,
    "low": pl.Float64,
    "high": pl.Float64,
}
STANDS_FOR = {
    "mean": ("mean", "skewed mean"),
    "rate": ("rate", "episodes"),
    "median": ("median",),
    "set": ("fid", "kid"),
    "score": ("score",),
    "difference": ("difference",),
    "score difference": ("score difference",),
}
"""Kinds of intervals, and the studied ones whose lowest coverage is said to be theirs."""


def read_anchors(folder: Path) -> Anchors:
    """Return the anchors of the ranked metrics from the scores of mean-image and noise-ceiling.

    Raises:
        RacinesError: scores that are missing or damaged.
    """
    import json

    found = []
    for name in ("mean-image", "noise-ceiling"):
        path = folder / f"{name}.json"
        try:
            figures = json.loads(path.read_text(encoding="utf-8"))["metrics"]
            found.append([float(figures[metric]["value"]) for metric in RANKED])
        except (OSError, ValueError, KeyError, TypeError) as error:
            hint = f"racines eval generator {name}, or --scores FOLDER"
            raise RacinesError(f"{path}: no scores to anchor by ({error}); {hint}") from error
    return {name: (zero, one) for name, zero, one in zip(RANKED, *found, strict=True)}


def cells(config: CoverageConfig) -> list[tuple[str, int, int, int]]:
    """Return (items or sets, units, trainings, studies) in the order in which they are drawn."""
    return [
        (what, units, trainings, studies)
        for what, studies in (("items", config.studies), ("sets", config.set_studies))
        for units in config.units
        for trainings in config.trainings
    ]


def rows_file(folder: Path, population: Population, config: CoverageConfig, of: Anchors) -> Path:
    """Return where studies are kept: the name says all that one of them depends on.

    The numbers of studies, units and trainings are no part of it: each study has its own seed.
    """
    kept = asdict(config)
    for name in ("studies", "set_studies", "units", "trainings"):
        del kept[name]
    told = [kept, sorted(of.items()), probe()]
    arrays: list[Any] = [population.truth]
    for method in (population.first, population.second):
        arrays += [method.features, *method.figures.values()]
    seen = [hashlib.sha256(np.ascontiguousarray(each).data).hexdigest() for each in arrays]
    return folder / f"coverage-{sha256_bytes(repr([told, seen]).encode())[:24]}.parquet"


def simulate(simulation: Simulation, kept: Path, progress: Progress | None = None) -> pl.DataFrame:
    """Draw the studies that are not yet in a file; return all that were asked for.

    Raises:
        RacinesError: the file is not what a former run left.
    """
    rows = _read(kept) if kept.is_file() else pl.DataFrame(schema=ROWS)
    for what, units, trainings, studies in cells(simulation.config):
        mine = (pl.col("what") == what, pl.col("units") == units, pl.col("trainings") == trainings)
        there = set(rows.filter(*mine)["study"].to_list())
        if progress is not None:
            progress(min(len(there), studies))
        wanted = [study for study in range(studies) if study not in there]
        draw = simulation.items if what == "items" else simulation.sets
        for start in range(0, len(wanted), CHUNK):
            chunk = wanted[start : start + CHUNK]
            drawn = [
                (what, kind, units, trainings, study, found.value, found.low, found.high)
                for study in chunk
                for kind, found in draw(units, trainings, study)
            ]
            rows = pl.concat([rows, pl.DataFrame(drawn, schema=ROWS, orient="row")])
            write_atomic(kept, _parquet(rows))
            if progress is not None:
                progress(len(chunk))
    return rows


def _parquet(rows: pl.DataFrame) -> bytes:
    import io

    out = io.BytesIO()
    rows.write_parquet(out)
    return out.getvalue()


def _read(path: Path) -> pl.DataFrame:
    try:
        rows = pl.read_parquet(path)
    except (OSError, pl.exceptions.PolarsError) as error:
        raise RacinesError(f"{path}: damaged ({error}); delete it and start anew") from error
    if dict(rows.schema) != ROWS:
        raise RacinesError(f"{path}: other columns than studies have; delete it and start anew")
    return rows


def report(
    simulation: Simulation,
    rows: pl.DataFrame,
    dataset: Mapping[str, Any],
    methods: Any,
    began: float,
) -> dict[str, Any]:
    """Return the report: the coverage of each kind at each size, with its own interval."""
    config, population = simulation.config, simulation.population
    found = []
    for what, units, trainings, studies in cells(config):
        targets = simulation.targets(trainings) if what == "items" else {}
        part = rows.filter(
            pl.col("units") == units, pl.col("trainings") == trainings, pl.col("study") < studies
        )
        for kind in ITEMS if what == "items" else SETS:
            value, low, high = (
                part.filter(pl.col("kind") == kind)[key].to_numpy()
                for key in ("value", "low", "high")
            )
            target = targets.get(kind, float(value.mean()))
            found.append(
                {"kind": kind, "units": units, "trainings": trainings}
                | _covered(target, value, low, high)
            )
    lengths = np.bincount(population.unit)
    return {
        "schema": SCHEMA,
        "dataset": dict(dataset),
        "population": {
            "trajectories": population.units,
            "frames": len(population.unit),
            "frames_of_a_trajectory": [int(lengths.min()), int(lengths.max())],
            "embedded": len(population.embedded),
            "methods": methods,
        },
        "settings": asdict(config),
        "anchors": {name: list(each) for name, each in simulation.anchors.items()},
        "rows": found,
        "levels": levels(found),
        "table": shares_table(found),
        "probe": probe(),
        "code": code_version(),
        "environment": environment(),
        "seconds": round(time.perf_counter() - began, 3),
    }


def _covered(target: float, value: np.ndarray, low: np.ndarray, high: np.ndarray) -> dict[str, Any]:
    """Return the share of intervals that hold the target, and on which side the others miss it."""
    held = float(((low <= target) & (target <= high)).mean())
    ends = wilson_ends(held, len(value))
    return {
        "n": len(value),
        "coverage": round(held, 4),
        "low": round(ends[0], 4),
        "high": round(ends[1], 4),
        "target": target,
        "mean": float(value.mean()),
        "interval_above": round(float((low > target).mean()), 4),
        "interval_below": round(float((high < target).mean()), 4),
        "width": float(np.median(high - low)),
    }


def shares_table(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the coverage in per cent, a row a kind: studies of one training, then of several."""
    sizes = sorted({(row["trainings"], row["units"]) for row in found})
    shares = {(r["kind"], r["trainings"], r["units"]): f"{100 * r['coverage']:.1f}" for r in found}
    names = [f"{units} units" if count < 2 else f"{units}, {count} t." for count, units in sizes]
    kinds = dict.fromkeys(row["kind"] for row in found)
    rows = [[kind, *(shares.get((kind, *size), "–") for size in sizes)] for kind in kinds]
    return {"columns": ["interval of", *names], "rows": rows}


def levels(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the table that intervals are printed with: by kind, the coverage at each size."""
    table: dict[str, list[dict[str, Any]]] = {}
    for kind, studied in STANDS_FOR.items():
        sizes = {(row["units"], row["trainings"]) for row in found}
        table[kind] = [
            {"units": units, "trainings": trainings, "coverage": min(shares)}
            for units, trainings in sorted(sizes)
            if (
                shares := [
                    row["coverage"]
                    for row in found
                    if row["kind"] in studied
                    and (row["units"], row["trainings"]) == (units, trainings)
                ]
            )
        ]
    return {"nominal": LEVEL, "coverage": table}


def probe() -> list[list[float]]:
    """Return the ends of some intervals, by which a change of their method is noticed."""
    ends = []
    for units in (7, 45):
        generator = np.random.default_rng(units)
        unit = np.repeat(np.arange(units), generator.integers(2, 9, units))
        values = generator.gamma(2.0, 1.0, units)[unit] + generator.gamma(1.0, 1.0, (3, len(unit)))
        for some in (values[:1], values):
            one, two = mean_replicates(some, unit), mean_replicates(some[:, ::-1], unit)
            found = (
                interval(one),
                rate_interval(some < 6.0, unit),
                median_interval(some, unit),
                difference(one, two),
            )
            ends += [[float(f"{end:.9g}") for end in (f.low or 0.0, f.high or 0.0)] for f in found]
    return ends


def draw_coverage(content: dict[str, Any]) -> bytes:
    """Return a PNG of coverage against the number of units, one panel for each of trainings."""
    from matplotlib.figure import Figure

    from racines_data.plotting import INK, MUTED, SMALL, card_style, encode

    with card_style():
        rows = content["rows"]
        trainings = sorted({row["trainings"] for row in rows})
        figure = Figure(figsize=(8.4, 3.4), layout="constrained")
        panels = figure.subplots(1, len(trainings), sharey=True, squeeze=False)[0]
        for axes, count in zip(panels, trainings, strict=True):
            for number, kind in enumerate(dict.fromkeys(row["kind"] for row in rows)):
                mine = [r for r in rows if (r["kind"], r["trainings"]) == (kind, count)]
                units = [row["units"] for row in mine]
                # Colours begin again after eight: then the marks differ.
                look = {"marker": "os"[number // 8 % 2]}
                if kind == "frames as units":
                    look = {"color": INK, "ls": "--"}
                axes.plot(units, [r["coverage"] for r in mine], label=kind, markersize=3, **look)
            axes.axhspan(0.93, 0.97, color=MUTED, alpha=0.2, linewidth=0)
            axes.set(xscale="log", xlabel="units, n", title=f"{count} training{'s'[: count > 1]}")
            ticks = sorted({row["units"] for row in rows})
            axes.set_xticks(ticks, [str(each) for each in ticks])
            axes.minorticks_off()
        panels[0].set_ylabel("share of intervals that hold the value")
        lines, names = panels[-1].get_legend_handles_labels()
        figure.legend(lines, names, fontsize=SMALL, loc="outside right center")
        return encode(figure)
