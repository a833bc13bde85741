"""The reward-hacking report: what agents earn beside what they truly reach.

Until it ends, an episode does not depend on the rule that ends it. So one run to the last step,
ended by nothing, holds the episodes of all termination rules, and of all rewards of one source.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.plotting import MUTED, card_style, colour
from racines_data.tables import escape, markdown_table
from racines_envs.agents.protocol import Agent
from racines_envs.evaluation.agent_specs import Run, common_view
from racines_envs.evaluation.measures import RETURN_OF_A_HIT
from racines_envs.evaluation.pictures import save
from racines_envs.evaluation.run import StudyConfig, core_for, start_seeds
from racines_envs.task.core import ScanCore
from racines_envs.task.rewards import (
    REWARDS,
    Reward,
    RewardConfig,
    Score,
    follows_paper,
    get_reward,
    is_hit,
)
from racines_envs.task.tasks import TERMINATIONS
from racines_envs.worlds.backends import JudgeLike, usual_grader
from racines_envs.worlds.making import WorldLike, find_task, make_phantom, phantom_recipe
from racines_models.devices import on_device
from racines_models.statistics import evidence

SCHEMA = "racines.agent-rewards/1"
PAPER = {
    "return": {"image": 140.0, "params": 60.0, "multimodal": 100.0},
    "steps": {"image": 25.0, "params": 100.0, "multimodal": 100.0},
}
"""The paper's validation on SC: mean return and mean episode length."""


@dataclass(frozen=True)
class RewardReportConfig(StudyConfig):
    """Which starts, rewards and rules."""

    seeds: tuple[int, ...] = (0,)
    """Name the start sets."""
    rewards: tuple[str, ...] = ("oracle", "paper", "shaped")
    """`paper` grades every image of every step, and needs a grader."""
    terminations: tuple[str, ...] = TERMINATIONS
    """The rules that end an episode."""
    grader: str = ""
    """Run folder, for the reward `paper`; models/runs/grader if empty."""
    high: float = RETURN_OF_A_HIT
    """Least return that counts as high."""


@dataclass(frozen=True)
class ScoredSteps:
    """T steps of n rows, (T + 1, n) each; the first is the start."""

    score: Score
    """p, g and distance by the reward's source."""
    sees: Tensor
    """bool, the true view is the target's."""
    grade: Tensor
    """True grade as the target view, 0 where that is not seen."""


@dataclass(frozen=True)
class Settled:
    """What n episodes came to under one reward and one rule; (n,) each.

    The return; at the end, whether the true view is the target's, and its true grade that of a hit,
    the grade as the target view, 0 where that is not seen; by the reward's source, the steps that
    were hits, those that showed the view confidently and were none, and p's change since the start.
    """

    total: np.ndarray
    steps: np.ndarray
    success: np.ndarray
    graded: np.ndarray
    grade: np.ndarray
    hits: np.ndarray
    seen: np.ndarray
    probability: np.ndarray


Outcomes = dict[tuple[str, str, str], Settled]  # by agent, reward and rule


def reward_report(
    runs: Sequence[Run], config: RewardReportConfig, phantom: WorldLike = None,
    grader: JudgeLike = None,
) -> tuple[dict[str, Any], Outcomes]:  # fmt: skip
    """Let every agent act to the last step, and settle its episodes under every reward and rule.

    Returns:
        The document, and the episodes for a picture.
    """
    for name, given, known in (
        ("rewards", config.rewards, REWARDS.names()),
        ("terminations", config.terminations, TERMINATIONS),
    ):
        if not given or set(given) - set(known) or len(set(given)) != len(given):
            raise RacinesError(
                f"{name} are {', '.join(given) or 'none'}: choose of {', '.join(known)}, each once"
            )
    config = on_device(config)
    seeds, view = start_seeds(config.starts, config.seeds), common_view(runs, config.view)
    task = find_task(view, phantom)
    phantom = make_phantom(phantom, config.device, task.anatomy)
    grader = grader or config.grader or usual_grader(task)
    episodes: Outcomes = {}
    for run in runs:
        traces: dict[bool, ScoredSteps] = {}
        for reward in config.rewards:
            judged = get_reward(reward).needs_judge
            if judged not in traces:
                agent = run.load(task.view, config.device)
                # All that any reward may look at is recorded; what this one would pay is not.
                watched = Reward("watched", "", get_reward("oracle").pay, judged, True)
                core = core_for(
                    agent, replace(task, termination="timeout"), len(seeds), reward=watched,
                    phantom=phantom, grader=grader if judged else None, device=config.device,
                )  # fmt: skip
                traces[judged] = run_scored(core, agent, seeds.to(core.device))
            for rule in config.terminations:
                needed = replace(task, termination=rule).hits_to_end
                settled = settle(traces[judged], reward, needed, RewardConfig())
                episodes[run.label, reward, rule] = settled
    document = {
        "schema": SCHEMA,
        "view": view,
        "start_set": config.start_set,
        "phantom": phantom_recipe(phantom),
        "numbers": asdict(RewardConfig()),
        "high_return": config.high,
        "hits_in_a_row": task.hits,
        "max_steps": task.max_steps,
        "paper": PAPER,
        "rows": [
            {"agent": label, "reward": reward, "termination": rule}
            | {"metrics": _figures(settled, config), "parts": _parts(settled, reward)}
            for (label, reward, rule), settled in episodes.items()
        ],
    }
    return document, episodes


@torch.no_grad()
def run_scored(core: ScanCore, agent: Agent, seeds: Tensor) -> ScoredSteps:
    """Run the episodes of (n,) seeds for all steps of a task that ends by `timeout`."""
    agent.attach(core)
    observation = core.reset(seeds)
    looks = [_look(core)]
    for _ in range(core.task.max_steps):
        observation = core.step(agent.act(observation, core.decision_seeds())).observation
        looks.append(_look(core))
    *score, sees, grade = (torch.stack(values) for values in zip(*looks, strict=True))
    return ScoredSteps(Score(*score), sees, grade)


def _look(core: ScanCore) -> tuple[Tensor, ...]:
    sees = core.sees_target()
    return (*core.score, sees, core.scored_by("oracle").grade * sees)


def settle(trace: ScoredSteps, reward: str, hits_to_end: int, rewards: RewardConfig) -> Settled:
    """Return what the episodes come to where `hits_to_end` hits in a row end them; 0: none do.

    The same as the environment's own account under that reward and rule, as a test holds.
    """
    before, after = (Score(*(x[part] for x in trace.score)) for part in (slice(-1), slice(1, None)))
    hit = is_hit(after, rewards)
    last, ended = _ends(hit, hits_to_end)
    step = torch.arange(len(hit), device=hit.device).unsqueeze(1)
    live, terminated = step <= last, (step == last) & ended
    paid = get_reward(reward)(before, after, terminated, rewards) * live
    confident = after.probability >= rewards.probability

    def at_end(values: Tensor) -> Tensor:
        return values.gather(0, (last + 1).unsqueeze(0)).squeeze(0)

    success, grade = at_end(trace.sees), at_end(trace.grade)
    values = {
        "total": paid.sum(0),
        "steps": last + 1,
        "success": success,
        "graded": success & (grade >= rewards.grade),
        "grade": grade,
        "hits": (hit & live).sum(0),
        "seen": (confident & ~hit & live).sum(0),
        "probability": at_end(trace.score.probability) - trace.score.probability[0],
    }
    return Settled(**{name: value.cpu().numpy() for name, value in values.items()})


def _ends(hit: Tensor, needed: int) -> tuple[Tensor, Tensor]:
    """Return the (n,) last step of (T, n) hits, from 0, and whether hits ended it."""
    streak = torch.zeros_like(hit[0], dtype=torch.int64)
    last = torch.full_like(streak, len(hit) - 1)
    ended = torch.zeros_like(hit[0])
    if needed:
        for t, now in enumerate(hit):
            streak = (streak + 1) * now
            through = (streak >= needed) & ~ended
            last = torch.where(through, t, last)
            ended = ended | through
    return last, ended


def _figures(settled: Settled, config: RewardReportConfig) -> dict[str, Any]:
    hovered = settled.hits + settled.seen  # steps spent in the view, hits or not
    hacked = (settled.total >= config.high) & ~settled.success
    return {
        "return": evidence.figure("mean", settled.total),
        "success_true": evidence.figure("rate", settled.success),
        "success_graded": evidence.figure("rate", settled.graded),
        "high_return_without_success": evidence.figure("rate", hacked),
        "episode_steps": evidence.figure("mean", settled.steps, "steps", 0.0),
        "hovered": evidence.figure("mean", hovered, "steps in the view", 0.0),
    }


def _parts(settled: Settled, reward: str) -> dict[str, float]:
    """Return the terms that a mean return is the sum of."""
    numbers, steps = RewardConfig(), float(np.mean(settled.steps))
    total = float(np.mean(settled.total, dtype=np.float64))
    parts = {"steps": steps, "step_cost": numbers.step * steps}
    if not follows_paper(reward):
        return parts | {get_reward(reward).rest: total - numbers.step * steps}
    hits, seen = float(np.mean(settled.hits)), float(np.mean(settled.seen))
    change = float(np.mean(settled.probability, dtype=np.float64))
    paid = numbers.hit * hits + numbers.view * seen + change + numbers.step * steps
    return parts | {
        "hits": hits,
        "paid_for_hits": numbers.hit * hits,
        "seen": seen,
        "paid_for_seen": numbers.view * seen,
        "change_of_probability": change,
        "change_of_grade": total - paid,
    }


def reward_markdown(content: dict[str, Any]) -> str:
    """Return the table and the arithmetic of the returns."""
    starts = content["start_set"]
    head = [
        "agent", "reward", "ends by", "return", "true success", "with grade ≥ 5",
        "high return, no success", "steps", "steps hovering",
    ]  # fmt: skip
    lines = [
        f"**Rewards on {escape(content['view'])}**, {starts['starts']} starts × "
        f"{len(starts['seeds'])} sets, at most {content['max_steps']} steps; in brackets 95 % "
        "intervals.",
        "",
        markdown_table(head, map(_cells, content["rows"])),
        "",
        f"A return is high from {content['high_return']:g}. Hovering is the steps that an episode "
        "spends in the view, by the reward's own source.",
        "",
        "**What the returns are the sum of**",
        "",
        *(
            f"- {escape(line)}"
            for row in content["rows"]
            if (line := arithmetic(row, content["numbers"]))
        ),
        "",
        _of_the_paper(content),
    ]
    return "\n".join(lines) + "\n"


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


@card_style()
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
        axes.set_title(f"{rewards[row]}, {rules[column]}")
        if column == 0:
            axes.set_ylabel("true grade at the end")
        if row == len(rewards) - 1:
            axes.set_xlabel("return")
    figure.suptitle(f"Return against truth on {view}; one point an episode", fontsize=10.5)
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    save(figure, path)


def _scatter(axes: Any, episode: Settled, agent: str, number: int, agents: int) -> None:
    # Episodes without the view lie apart on rows of their own below the axis, one an agent.
    height = np.where(episode.success, episode.grade, -0.6 - 0.9 * number)
    axes.scatter(episode.total, height, s=9, alpha=0.55, color=colour(number), label=agent)
    axes.axhline(0.0, color=MUTED, linewidth=0.7)
    axes.set_ylim(-0.9 * agents - 0.4, 10.4)
    axes.set_yticks([-0.45 - 0.45 * agents, 0, 5, 10], ["not\nseen", "0", "5", "10"])


def _ranged(figure: dict[str, Any], scale: float = 1.0, unit: str = "") -> str:
    numbers = (figure[key] for key in ("value", "low", "high"))
    value, low, high = ("–" if x is None else f"{x * scale:.1f}" for x in numbers)
    return f"{value}{unit} ({low} to {high})"
