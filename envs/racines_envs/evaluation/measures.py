"""The figures of a set of episodes, pooled and by start set; and how long one decision takes."""

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_envs.agents.protocol import Agent
from racines_envs.agents.rollout import Episodes
from racines_envs.task.core import ScanCore
from racines_models.statistics import bootstrap as statistics

RETURN_OF_A_HIT = 50.0
LEAST, WARM_UP = 50, 10
"""Decisions: the fewest whose times are worth a median, and those before that are not counted."""
PAPER_MS = 22.0
"""The paper's: 16 steps in 0.36 s, 22 in 0.42 s and 32 in 0.56 s are 22, 19 and 18 ms a step."""
Figures = dict[str, dict[str, Any]]
_OPTIONAL = (("view_position_error", 1e3, "mm"), ("view_rotation_error", 180.0 / np.pi, "degrees"))
"""What an environment may tell beside: key of its info, factor, unit."""


def measure(episodes: Episodes, reference_steps: np.ndarray, resamples: int = 2000) -> Figures:
    """Return the figures of n episodes.

    SPL is the mean of success × l / max(l, steps) (Anderson et al., On Evaluation of Embodied
    Navigation Agents, 2018) with l the oracle planner's steps from the same start, (n,).
    """
    final = episodes.final
    success, steps = final["success"], final["steps"]
    spl = path_length_score(success, steps, reference_steps)
    violations = final["workspace_hits"] + final["force_hits"]
    farmed = (final["return"] >= RETURN_OF_A_HIT) & ~success

    mean = partial(statistics.mean, resamples=resamples)
    figures = {
        "success_true": statistics.wilson(success),
        "success_graded": statistics.wilson(final["success_graded"]),
        "steps": mean(steps[success], "steps of the episodes with true success"),
        "steps_median": statistics.median(steps[success], "steps", resamples),
        "episode_steps": mean(steps, "steps"),
        "spl": mean(spl),
        "final_grade": mean(final["grade"]),
        "return": mean(final["return"]),
        "peak_force": mean(final["peak_force"], "N"),
        "mean_force": mean(final["mean_force"], "N"),
        "violations": mean(violations, "refused steps an episode"),
        "position_error": mean(final["position_error"] * 1e3, "mm"),
        "rotation_error": mean(np.degrees(final["rotation_error"]), "degrees"),
        "return_without_success": statistics.wilson(farmed),
    }
    for name, factor, unit in _OPTIONAL:
        if name in final:
            figures[name] = mean(final[name] * factor, unit)
    if "out_of_support" in final:
        figures["out_of_support"] = statistics.wilson(final["out_of_support"])
    middles = {"episode_steps": steps, "spl": spl}
    middles |= {"final_grade": final["grade"], "return": final["return"]}
    for name, values in middles.items():
        figures[f"{name}_iqm"] = statistics.interquartile_mean(values, None, resamples)
    return figures


def measure_by_seed(
    episodes: Episodes, reference_steps: np.ndarray, seeds: Sequence[int], resamples: int = 2000
) -> dict[str, Figures]:
    """Return the figures of each start set; the episodes stand in the order of the sets."""
    each = {}
    parts = np.split(np.arange(len(reference_steps)), len(seeds))
    for seed, rows in zip(seeds, parts, strict=True):
        final = {name: values[rows] for name, values in episodes.final.items()}
        each[str(seed)] = measure(replace(episodes, final=final), reference_steps[rows], resamples)
    return each


def path_length_score(
    success: np.ndarray, steps: np.ndarray, reference_steps: np.ndarray
) -> np.ndarray:
    """Return (…,) success weighted by path length; all of one shape, or to be broadcast."""
    return success * reference_steps / np.maximum(reference_steps, np.maximum(steps, 1))


@torch.no_grad()
def latency(
    core: ScanCore, agent: Agent, seeds: Tensor, decisions: int, resamples: int
) -> dict[str, Any]:
    """Return the median ms that policy and step took, one probe at a time, the paper's beside it.

    The core has one row. When one of the (E,) episodes ends the next begins, and that reset is not
    timed; nor is a warm-up. The decisions have to be enough for a median worth reading.
    """
    if decisions < LEAST:
        raise RacinesError(
            f"evaluation.latency is {decisions}: give at least {LEAST}, or 0 for none"
        )
    agent.attach(core)
    observation, episode, times = core.reset(seeds[:1]), 0, []
    while len(times) < WARM_UP + decisions:
        if bool(core.state.done):
            episode = (episode + 1) % len(seeds)
            observation = core.reset(seeds[episode : episode + 1])
        began = time.perf_counter()
        observation = core.step(agent.act(observation, core.decision_seeds())).observation
        bool(core.state.done)  # waits for the device
        times.append((time.perf_counter() - began) * 1e3)
    figure = statistics.median(np.asarray(times[WARM_UP:]), "ms", resamples)
    figure["settings"] |= {
        "interval": f"percentile bootstrap over decisions, {resamples} resamples",
        "batch": 1,
        "counts": "policy and environment step",
        "threads": torch.get_num_threads(),
        "paper_ms": PAPER_MS,
    }
    return figure
