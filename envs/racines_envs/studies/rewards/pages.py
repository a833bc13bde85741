"""The reward-hacking report as Markdown, and returns against the truth as a picture."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from racines_data.tables import markdown_table
from racines_envs.evaluation.pictures import save
from racines_envs.studies.rewards.report import Outcomes, Settled


def reward_markdown(content: dict[str, Any]) -> str:
    """Return the table and the arithmetic of the returns."""
    starts = content["start_set"]
    lines = [
        f"**Rewards on {content['view']}**, {starts['starts']} starts × {len(starts['seeds'])} "
        f"sets, at most {content['max_steps']} steps; in brackets 95 % intervals.",
        "",
        markdown_table(_HEAD, map(_cells, content["rows"])),
        "",
        f"A return is high from {content['high_return']:g}. Hovering is the steps that an episode "
        "spends in the view, by the reward's own source.",
        "",
        "**What the returns are the sum of**",
        "",
        *(f"- {line}" for row in content["rows"] if (line := arithmetic(row, content["numbers"]))),
        "",
        _of_the_paper(content),
    ]
    return "\n".join(lines) + "\n"


_HEAD = [
    "agent", "reward", "ends by", "return", "true success", "with grade ≥ 5",
    "high return, no success", "steps", "steps hovering",
]  # fmt: skip


def _cells(row: dict[str, Any]) -> list[str]:
    figures = row["metrics"]
    rates = ("success_true", "success_graded", "high_return_without_success")
    return [
        *(row[name] for name in ("agent", "reward", "termination")),
        _ranged(figures["return"]),
        *(_ranged(figures[name], 100.0, " %") for name in rates),
        *(f"{figures[name]['value']:.1f}" for name in ("episode_steps", "hovered")),
    ]


def arithmetic(row: dict[str, Any], numbers: dict[str, float]) -> str:
    """Return the sum that a mean return under the paper's formula is; nothing for another."""
    parts = row["parts"]
    if "hits" not in parts:
        return ""
    return (
        f"{row['agent']}, {row['reward']}, {row['termination']}: "
        f"{numbers['hit']:g} × {parts['hits']:.2f} hits + {numbers['view']:g} × "
        f"{parts['seen']:.2f} steps in a poor view {parts['change_of_probability']:+.2f} (change "
        f"of p) {parts['change_of_grade']:+.2f} (change of g) {numbers['step']:+g} × "
        f"{parts['steps']:.1f} steps = {row['metrics']['return']['value']:.1f}"
    )


def _of_the_paper(content: dict[str, Any]) -> str:
    numbers, hits, most = content["numbers"], content["hits_in_a_row"], content["max_steps"]
    told, steps = (content["paper"][name]["image"] for name in ("return", "steps"))
    hit, cost = numbers["hit"], numbers["step"] * steps
    once, often = hit + 1 + cost, hit * hits + 1 + cost
    ever = hit * (most - steps) + numbers["step"] * most
    return (
        f"The paper reports a mean return of about {told:g} at about {steps:g} steps (image, SC) "
        "and not what ends an episode. An episode that succeeds in "
        f"{steps:g} steps earns, before poor views and changes of the grade, {once:.1f} where the "
        f"first hit ends it, {often:.1f} where {hits} hits in a row do, and {ever:,.0f} where "
        f"nothing does. Only {hits} hits in a row come near."
    )


def draw_returns(episodes: Outcomes, view: str, path: Path) -> None:
    """Draw return against true grade at the end, a panel a reward and rule; PNG.

    An episode right of the line has a high return; below 0 it does not show the view.
    """
    agents, rewards, rules = (list(dict.fromkeys(key[i] for key in episodes)) for i in range(3))
    size = (2.9 * len(rules) + 1.0, 2.5 * len(rewards) + 0.9)
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(len(rewards), len(rules), sharey=True, squeeze=False)
    for (row, column), axes in np.ndenumerate(grid):
        for number, agent in enumerate(agents):
            episode = episodes[agent, rewards[row], rules[column]]
            _scatter(axes, episode, agent, number, len(agents))
        axes.set_title(f"{rewards[row]}, {rules[column]}", fontsize=9)
        axes.tick_params(labelsize=8)
        if column == 0:
            axes.set_ylabel("true grade at the end", fontsize=8)
        if row == len(rewards) - 1:
            axes.set_xlabel("return", fontsize=8)
    figure.suptitle(f"Return against truth on {view}; one point an episode", fontsize=10)
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    save(figure, path)


def _scatter(axes: Any, episode: Settled, agent: str, number: int, agents: int) -> None:
    # Episodes without the view lie apart on rows of their own below the axis, one an agent.
    height = np.where(episode.success, episode.grade, -0.6 - 0.9 * number)
    axes.scatter(episode.total, height, s=9, alpha=0.55, color=f"C{number}", label=agent)
    axes.axhline(0.0, color="0.6", linewidth=0.7)
    axes.set_ylim(-0.9 * agents - 0.4, 10.4)
    axes.set_yticks([-0.45 - 0.45 * agents, 0, 5, 10], ["not\nseen", "0", "5", "10"])


def _ranged(figure: dict[str, Any], scale: float = 1.0, unit: str = "") -> str:
    numbers = (figure[key] for key in ("value", "low", "high"))
    value, low, high = ("–" if x is None else f"{x * scale:.1f}" for x in numbers)
    return f"{value}{unit} ({low} to {high})"
