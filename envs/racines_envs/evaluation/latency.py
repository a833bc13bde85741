"""How long one decision takes: the policy and the environment's step, one probe at a time."""

import time
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_envs.agents.protocol import Agent
from racines_envs.task.core import ScanCore
from racines_models import statistics

LEAST = 50
WARM_UP = 10
PAPER_MS = 22.0
"""The paper's: 16 steps in 0.36 s, 22 in 0.42 s and 32 in 0.56 s are 22, 19 and 18 ms a step."""


@torch.no_grad()
def decision_times(core: ScanCore, agent: Agent, seeds: Tensor, decisions: int) -> np.ndarray:
    """Return (decisions,) ms that a decision took, after a warm-up.

    Args:
        core: Of one row.
        agent: Attached here.
        seeds: (E,) episodes; when one ends the next begins, and that reset is not timed.
        decisions: How many to time, at least 50.

    Raises:
        RacinesError: fewer decisions than make a median worth reading.
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
    return np.asarray(times[WARM_UP:])


def latency_figure(times: np.ndarray, resamples: int) -> dict[str, Any]:
    """Return the median of (n,) ms, as scores files hold it, the paper's beside it."""
    figure = statistics.median(times, "ms", resamples)
    settings = figure["settings"] | {
        "interval": f"percentile bootstrap over decisions, {resamples} resamples",
        "batch": 1,
        "counts": "policy and environment step",
        "threads": torch.get_num_threads(),
        "paper_ms": PAPER_MS,
    }
    return figure | {"settings": settings}
