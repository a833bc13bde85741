"""The reward-hacking report: what agents earn beside what they truly reach."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.world import World
from racines_envs.evaluation.agent_specs import Run, common_view
from racines_envs.evaluation.measures import RETURN_OF_A_HIT
from racines_envs.evaluation.run import check_view, start_seeds
from racines_envs.studies.rewards.settlement import ScoredSteps, Settled, run_scored, settle
from racines_envs.task.rewards import REWARDS, Reward, RewardConfig, follows_paper, get_reward
from racines_envs.task.tasks import TERMINATIONS, Task
from racines_envs.worlds.backends import GRADER_FOLDER, JudgeLike
from racines_envs.worlds.making import WorldLike, find_task, make_core, make_phantom, phantom_recipe
from racines_models import statistics
from racines_models.devices import on_device

SCHEMA = "racines.agent-rewards/1"
PAPER = {
    "return": {"image": 140.0, "params": 60.0, "multimodal": 100.0},
    "steps": {"image": 25.0, "params": 100.0, "multimodal": 100.0},
}
"""The paper's validation on SC: mean return and mean episode length."""


@dataclass(frozen=True)
class RewardReportConfig:
    """Which starts, rewards and rules."""

    view: str = ""
    """The target view; that of the agents if empty."""
    starts: int = 100
    """Episodes from each start set."""
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
    resamples: int = 2000
    """Bootstrap resamples of each interval."""
    device: str = "cpu"


def reward_report(
    runs: Sequence[Run],
    config: RewardReportConfig,
    phantom: WorldLike = None,
    grader: JudgeLike = None,
) -> tuple[dict[str, Any], dict[tuple[str, str, str], Settled]]:
    """Let every agent act to the last step, and settle its episodes under every reward and rule.

    Returns:
        The document, and the episodes by (agent, reward, rule) for a picture.

    Raises:
        RacinesError: an unknown reward or rule, no grader for one that needs it, or agents that do
            not fit.
    """
    _check(config)
    config = on_device(config)
    seeds, view = start_seeds(config.starts, config.seeds), common_view(runs, config.view)
    task = find_task(view, phantom)
    phantom = make_phantom(phantom, config.device, task.anatomy)
    grader = grader or config.grader or GRADER_FOLDER
    episodes: dict[tuple[str, str, str], Settled] = {}
    for run in runs:
        traces: dict[bool, ScoredSteps] = {}
        for reward in config.rewards:
            judged = get_reward(reward).needs_judge
            if judged not in traces:
                judge = grader if judged else None
                traces[judged] = _trace(run, task, seeds, phantom, judge, config)
            for rule in config.terminations:
                needed = replace(task, termination=rule).hits_to_end
                settled = settle(traces[judged], reward, needed, RewardConfig())
                episodes[run.label, reward, rule] = settled
    document = {
        "schema": SCHEMA,
        "view": view,
        "start_set": {"seeds": list(config.seeds), "starts": config.starts},
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


def _check(config: RewardReportConfig) -> None:
    for name, given, known in (
        ("rewards", config.rewards, REWARDS.names()),
        ("terminations", config.terminations, TERMINATIONS),
    ):
        unknown = [value for value in given if value not in known]
        if unknown or not given or len(set(given)) != len(given):
            raise RacinesError(
                f"{name} are {', '.join(given) or 'none'}: choose of {', '.join(known)}, each once"
            )


def _trace(
    run: Run,
    task: Task,
    seeds: Tensor,
    phantom: World,
    grader: JudgeLike,
    config: RewardReportConfig,
) -> ScoredSteps:
    agent = run.load(config.device)
    # All that any reward may look at is recorded; what this one would pay is not.
    watched = Reward("watched", "", get_reward("oracle").pay, grader is not None, True)
    check_view(agent, task.view, run.agent, run.folder)
    core = make_core(
        task,
        len(seeds),
        observation=agent.observation,
        reward=watched,
        phantom=phantom,
        grader=grader,
        termination="timeout",
        encoder=getattr(agent, "encoder", None),
        device=config.device,
    )
    return run_scored(core, agent, seeds.to(core.device))


def _figures(settled: Settled, config: RewardReportConfig) -> dict[str, Any]:
    hacked = (settled.total >= config.high) & ~settled.success
    return {
        "return": statistics.mean(settled.total, None, config.resamples),
        "success_true": statistics.wilson(settled.success),
        "success_graded": statistics.wilson(settled.graded),
        "high_return_without_success": statistics.wilson(hacked),
        "episode_steps": statistics.mean(settled.steps, "steps", config.resamples),
        "hovered": statistics.mean(settled.hovered, "steps in the view", config.resamples),
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
