"""The transfer matrix as a heat map and as Markdown."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from racines_data.tables import markdown_table
from racines_envs.evaluation.pictures import save


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
        f"**Transfer on {content['view']}**: true success (95 %), steps of the successes, final "
        f"grade; {starts['starts']} starts × {len(starts['seeds'])} sets, judged by "
        f"{_judges(content['judged_by'])}.",
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


def draw_transfer(content: dict[str, Any], path: Path) -> None:
    """Draw true success as a heat map, steps and grade written into its cells; PNG."""
    backends, agents, cells = content["backends"], content["agents"], _cells(content)
    values = np.array(
        [[cells[a["label"], b]["success_true"]["value"] * 100 for b in backends] for a in agents]
    )
    size = (2.6 + 1.9 * len(backends), 1.7 + 0.75 * len(agents))
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots()
    image = axes.imshow(values, cmap="viridis", vmin=0, vmax=100, aspect="auto")
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
    axes.set(xlabel="evaluated in", title=f"True success on {content['view']}")
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
