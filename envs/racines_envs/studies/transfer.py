"""The transfer matrix: agents, each in every backend, and whether backends rank them alike.

Whatever draws the images and wherever an agent was trained, the phantom's truth judges; but
recordings of no phantom have only their own labels, and the document says so.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from racines_data.errors import RacinesError
from racines_data.plotting import LEVELS, card_style
from racines_data.tables import escape, markdown_table
from racines_envs.agents.rollout import rollout
from racines_envs.evaluation.agent_specs import Run, common_view
from racines_envs.evaluation.measures import METRICS, path_length_score
from racines_envs.evaluation.pictures import save
from racines_envs.evaluation.run import StudyConfig, core_for, reference_steps, start_seeds
from racines_envs.worlds.making import WorldLike, find_task, make_phantom, phantom_recipe
from racines_envs.worlds.replay import RecordedWorld
from racines_models.devices import on_device
from racines_models.statistics import LEVEL, evidence
from racines_models.statistics.ranks import kendall, spearman

SCHEMA = "racines.agent-transfer/1"
COMPARED = ("success_true", "episode_steps", "spl", "final_grade")
Scores = dict[tuple[str, str], dict[str, np.ndarray]]  # (n,) a figure, by agent and backend


@dataclass(frozen=True)
class TransferConfig(StudyConfig):
    """Which starts, and how exactly."""


def backend_arguments(spec: str) -> dict[str, Any]:
    """Return what `make_core` needs for `phantom`, `generator:NAME` or `replay:FOLDER`."""
    kind, _, what = spec.partition(":")
    given = {"phantom": {}, "generator": {"generator": what}, "replay": {"data": what}}.get(kind)
    if given is None or (kind == "phantom") != (not what):
        raise RacinesError(
            f"backend {spec!r}: give phantom, generator:<name, run folder or FILE.onnx>, or "
            "replay:<dataset folder>"
        )
    return {"backend": kind, **given}


def transfer(
    runs: Sequence[Run], backends: Sequence[str], config: TransferConfig, phantom: WorldLike = None
) -> dict[str, Any]:
    """Run every agent in every backend from the same starts.

    Returns:
        The document: `cells`, one an agent and backend, and `correlations`, one a pair of backends
        and figure.
    """
    if len(set(backends)) != len(backends) or not backends:
        raise RacinesError(f"backends are {', '.join(backends) or 'none'}: name each once")
    config = on_device(config)
    arguments = [backend_arguments(backend) for backend in backends]
    seeds, view = start_seeds(config.starts, config.seeds), common_view(runs, config.view)
    phantom = make_phantom(phantom, config.device, find_task(view, phantom).anatomy)
    shortest = reference_steps(view, seeds, phantom, config.device)
    scores: Scores = {}
    judges: dict[str, str] = {}
    for backend, drawn_by in zip(backends, arguments, strict=True):
        for run in runs:
            agent = run.load(view, config.device)
            core = core_for(
                agent, view, len(seeds), **drawn_by, reward="oracle", phantom=phantom,
                device=config.device,
            )  # fmt: skip
            drawn_by = {"backend": core.images}  # loaded once for all agents
            recorded = isinstance(core.phantom, RecordedWorld)
            judges[backend] = "the recorded labels" if recorded else "the phantom's truth"
            final = rollout(core, agent, seeds.to(core.device)).final
            steps = shortest
            if core.phantom is not phantom:  # recordings of no phantom, with starts of their own
                steps = reference_steps(view, seeds, core.phantom, config.device)
            scores[run.label, backend] = {
                "success_true": final["success"],
                "episode_steps": final["steps"],
                "spl": path_length_score(final["success"], final["steps"], steps),
                "final_grade": final["grade"],
            }
    return {
        "schema": SCHEMA,
        "view": view,
        "start_set": config.start_set,
        "phantom": phantom_recipe(phantom),
        "agents": [_describe(run) for run in runs],
        "backends": list(backends),
        "judged_by": judges,
        "cells": [
            {"agent": run.label, "backend": backend}
            | {"metrics": _metrics(scores[run.label, backend])}
            for run in runs
            for backend in backends
        ],
        "correlations": _correlations(runs, backends, scores, config.resamples),
    }


def _metrics(scores: dict[str, np.ndarray]) -> dict[str, Any]:
    steps = np.where(scores["success_true"], scores["episode_steps"], np.nan)
    values = {"success_true": scores["success_true"], "steps": steps, **scores}
    return {
        name: evidence.figure(what.statistic, values[name], what.unit, what.least, what.most)
        for name, what in METRICS.items()
        if name in values
    }


def _describe(run: Run) -> dict[str, Any]:
    """Say what an agent is and where it was trained."""
    config = run.config
    trained = config.get("backend", "")
    if trained == "generator":
        trained += f":{config.get('generator', '')}"
    told = {key: config[key] for key in ("observation", "reward") if key in config}
    return {"label": run.label, "agent": run.agent, "trained_in": trained or None, **told}


def _correlations(
    runs: Sequence[Run], backends: Sequence[str], scores: Scores, resamples: int
) -> list[dict[str, Any]]:
    found = []
    for pair in combinations(backends, 2) if len(runs) > 1 else ():
        for figure in COMPARED:
            x, y = (
                np.stack([scores[run.label, backend][figure] for run in runs]).astype(np.float64)
                for backend in pair
            )
            found.append({"backends": list(pair), "figure": figure} | correlate(x, y, resamples))
    return found


def correlate(x: np.ndarray, y: np.ndarray, resamples: int) -> dict[str, dict[str, Any]]:
    """Return both correlations of A agents' means over n starts, between two backends.

    Both hold (A, n) a score an agent and start. The interval is a percentile bootstrap over starts;
    one draw of starts serves all agents and both backends, since they share them. Draws in which a
    backend tells no agents apart have no correlation; they are left out and counted.
    """
    starts = x.shape[1]
    rows = np.random.default_rng(0).integers(0, starts, (resamples, starts))
    # Counting how often a start is drawn is one product, and no (A, resamples, n) array.
    weights = np.stack([np.bincount(row, minlength=starts) for row in rows]) / starts
    drawn = [np.round(weights @ values.T, 12) for values in (x, y)]
    whole = [np.round(values.mean(1), 12) for values in (x, y)]
    return {
        name: _figure(float(rule(*whole)), rule(*drawn), len(x))
        for name, rule in (("spearman", spearman), ("kendall", kendall))
    }


def _figure(value: float, drawn: np.ndarray, agents: int) -> dict[str, Any]:
    defined = drawn[np.isfinite(drawn)]
    figure: dict[str, Any] = {"value": None, "low": None, "high": None, "n": agents}
    if np.isfinite(value):
        low, high = np.quantile(defined, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2])
        figure |= {"value": value, "low": float(low), "high": float(high)}
    settings = {
        "interval": f"percentile bootstrap over starts, {len(drawn)} resamples",
        "undefined": len(drawn) - len(defined),
    }
    return figure | {"unit": "agents compared", "settings": settings}


def transfer_markdown(content: dict[str, Any]) -> str:
    """Return the matrix and the correlations as Markdown tables."""
    backends, cells, starts = content["backends"], _cells(content), content["start_set"]
    rows = [
        [
            agent["label"],
            _short(agent["trained_in"] or "–"),
            *(_outcome(cells[agent["label"], backend]) for backend in backends),
        ]
        for agent in content["agents"]
    ]
    lines = [
        f"**Transfer on {escape(content['view'])}**: true success (95 %), steps of the successes, "
        f"final grade; {starts['starts']} starts × {len(starts['seeds'])} sets, judged by "
        f"{escape(_judges(content['judged_by']))}.",
        "",
        markdown_table(["agent", "trained in", *map(_short, backends)], rows),
    ]
    if content["correlations"]:
        head = ["backends", "figure", "Spearman's ρ (95 %)", "Kendall's τ (95 %)"]
        rows = [
            [" and ".join(map(_short, found["backends"])), found["figure"]]
            + [_interval(found[name]) for name in ("spearman", "kendall")]
            for found in content["correlations"]
        ]
        lines += ["", markdown_table(head, rows)]
    return "\n".join(lines) + "\n"


@card_style()
def draw_transfer(content: dict[str, Any], path: Path) -> None:
    """Draw true success as a heat map, steps and grade written into its cells; PNG."""
    backends, agents, cells = content["backends"], content["agents"], _cells(content)
    values = np.array(
        [[cells[a["label"], b]["success_true"]["value"] * 100 for b in backends] for a in agents]
    )
    size = (2.6 + 1.9 * len(backends), 1.7 + 0.75 * len(agents))
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots()
    image = axes.imshow(values, cmap=LEVELS, vmin=0, vmax=100, aspect="auto")
    for (row, column), value in np.ndenumerate(values):
        metrics = cells[agents[row]["label"], backends[column]]
        steps, grade = metrics["steps"]["value"], metrics["final_grade"]["value"]
        text = f"{value:.0f} %\n{_number(steps, '.0f')} steps, grade {grade:.1f}"
        colour = "black" if value > 60 else "white"
        axes.text(column, row, text, ha="center", va="center", color=colour, fontsize=8.5)
    axes.set_xticks(range(len(backends)), [_short(backend) for backend in backends])
    places = [f"\n({_short(a['trained_in'])})" if a["trained_in"] else "" for a in agents]
    names = [f"{a['label']}{place}" for a, place in zip(agents, places, strict=True)]
    axes.set_yticks(range(len(agents)), names)
    axes.grid(visible=False)
    starts = content["start_set"]
    count = starts["starts"] * len(starts["seeds"])
    axes.set(xlabel="evaluated in", title=f"True success on {content['view']}, n = {count} starts")
    figure.colorbar(image, label="true success, %")
    save(figure, path)


def _cells(content: dict[str, Any]) -> dict[tuple[str, str], dict[str, Any]]:
    return {(cell["agent"], cell["backend"]): cell["metrics"] for cell in content["cells"]}


def _judges(judged_by: dict[str, str]) -> str:
    """Name the judge, or who judges where."""
    if len(set(judged_by.values())) == 1:
        return next(iter(judged_by.values()))
    return ", ".join(f"{judge} ({_short(backend)})" for backend, judge in judged_by.items())


def _short(backend: str) -> str:
    """Return a backend without the folders of its path."""
    kind, _, what = backend.partition(":")
    return f"{kind}:{Path(what).name}" if what else kind


def _outcome(metrics: dict[str, Any]) -> str:
    rate, low, high = (100 * metrics["success_true"][key] for key in ("value", "low", "high"))
    steps, grade = metrics["steps"]["value"], metrics["final_grade"]["value"]
    return f"{rate:.1f} % ({low:.1f}–{high:.1f}), {_number(steps, '.1f')}, {grade:.2f}"


def _interval(figure: dict[str, Any]) -> str:
    if figure["value"] is None:
        return "–"
    return f"{figure['value']:.2f} ({figure['low']:.2f} to {figure['high']:.2f})"


def _number(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)
