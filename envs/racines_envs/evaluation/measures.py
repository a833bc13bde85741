"""The figures of a set of episodes, pooled and by start set; and how long one decision takes."""

import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_envs.agents.protocol import Agent
from racines_envs.agents.rollout import Episodes
from racines_envs.task.core import ScanCore
from racines_models.statistics import Evidence, Figures, median
from racines_models.statistics.evidence import figure as figure_of
from racines_models.statistics.sets import set_replicates

RETURN_OF_A_HIT = 50.0
LEAST, WARM_UP = 50, 10
"""Decisions: the fewest whose times are worth a median, and those before that are not counted."""
PAPER_MS = 22.0
"""The paper's: 16 steps in 0.36 s, 22 in 0.42 s and 32 in 0.56 s are 22, 19 and 18 ms a step."""
Metrics = dict[str, dict[str, Any]]
Values = Mapping[str, np.ndarray]
"""By metric, (R, N) of R trainings and N episodes; NaN where there is nothing to measure."""


class Measured(NamedTuple):
    """What a metric is of its episodes, its unit, and the least and the most that it can be."""

    statistic: str
    unit: str | None = None
    least: float = -np.inf
    most: float = np.inf


_RATE, _GRADE = Measured("rate", None, 0.0, 1.0), Measured("mean", None, 0.0, 10.0)
_FORCE = Measured("mean", "N", 0.0)
_MM, _DEGREES = Measured("mean", "mm", 0.0), Measured("mean", "degrees", 0.0, 180.0)
METRICS = {
    "success_true": _RATE,
    "success_graded": _RATE,
    "steps": Measured("mean", "steps of the episodes with true success", 0.0),
    "steps_median": Measured("median", "steps", 0.0),
    "episode_steps": Measured("mean", "steps", 0.0),
    "spl": Measured("mean", None, 0.0, 1.0),
    "final_grade": _GRADE,
    "return": Measured("mean"),
    "peak_force": _FORCE,
    "mean_force": _FORCE,
    "violations": Measured("mean", "refused steps an episode", 0.0),
    "arm_hits": Measured("mean", "steps an episode that the arm could not follow", 0.0),
    "position_error": _MM,
    "rotation_error": _DEGREES,
    "return_without_success": _RATE,
    "view_position_error": _MM,
    "view_rotation_error": _DEGREES,
    "out_of_support": _RATE,
    "success_grader": _RATE,
    "success_declared": _RATE,
    "declared": _RATE,
    "false_declarations": _RATE,
    "reached": _RATE,
    "seconds": Measured("mean", "s", 0.0),
}
"""Every metric of episodes; some where environment or settings have them, or on patients alone."""
SPREAD = ("seconds", "position_error", "rotation_error")
"""Those on patients with a median and quartiles beside."""
QUARTILES = {"quartile": 0.25, "upper_quartile": 0.75}
MIDDLES = ("episode_steps", "spl", "final_grade", "return")
"""Those with an interquartile mean beside."""
_OPTIONAL = (("view_position_error", 1e3), ("view_rotation_error", 180.0 / np.pi))
"""What an environment may tell beside: key of its info, factor."""


def episode_values(trainings: Sequence[Episodes], reference_steps: np.ndarray) -> Values:
    """Return the figures of the N episodes of each of R trainings.

    SPL is the mean of success × l / max(l, steps) (Anderson et al., On Evaluation of Embodied
    Navigation Agents, 2018) with l the oracle planner's steps from the same start, (N,).
    """
    final = {
        name: np.stack([each.final[name] for each in trainings]).astype(np.float64)
        for name in trainings[0].final
    }
    success, steps = final["success"] > 0, final["steps"]
    of_successes = np.where(success, steps, np.nan)
    values = {
        "success_true": success,
        "success_graded": final["success_graded"],
        "steps": of_successes,
        "steps_median": of_successes,
        "episode_steps": steps,
        "spl": path_length_score(success, steps, reference_steps),
        "final_grade": final["grade"],
        "return": final["return"],
        "peak_force": final["peak_force"],
        "mean_force": final["mean_force"],
        "violations": final["workspace_hits"] + final["force_hits"],
        "position_error": final["position_error"] * 1e3,
        "rotation_error": np.degrees(final["rotation_error"]),
        "return_without_success": (final["return"] >= RETURN_OF_A_HIT) & ~success,
    }
    values |= {name: final[name] * factor for name, factor in _OPTIONAL if name in final}
    return values | {name: final[name] for name in ("out_of_support", "arm_hits") if name in final}


def measure(
    values: Values, units: np.ndarray | None = None, length: str = "mm"
) -> tuple[Metrics, Evidence]:
    """Return the metrics of episodes, and the evidence that they follow from.

    Items are the episodes' places, and the start of each is a unit of its own unless (N,) `units`
    say otherwise. `length` is what lengths are told in. What a training has no measurement of, such
    as the steps of successes where there is none, has no value.
    """
    evidence, metrics = Evidence(), {}
    places = np.arange(next(iter(values.values())).shape[1])
    units = places if units is None else units

    def told(what: Measured) -> str | None:
        return length if what.unit == "mm" else what.unit

    def tell(name: str, figures: Figures, what: Measured) -> None:
        found = figures.interval(what.least, what.most)
        metrics[name] = found.to_json(told(what))

    for name, each in values.items():
        what = METRICS[name]
        if np.isfinite(each).any(1).all():
            figures = evidence.add(name, what.statistic, each[:, None], places, units)
            tell(name, figures, what)
        else:
            metrics[name] = figure_of(what.statistic, [], told(what))
    for name in MIDDLES:
        middles = [lambda keep, row=row: interquartile_mean(row[keep]) for row in values[name]]
        kept = evidence.add_set(f"{name}_iqm", set_replicates(middles, units))
        tell(f"{name}_iqm", kept, METRICS[name]._replace(unit=None))
    return metrics, evidence


def interquartile_mean(values: np.ndarray) -> float:
    """Return the mean of (N,) values without a quarter, rounded down, at either end.

    The same bits as `scipy.stats.trim_mean`, whose checks take most of its time on so few values.
    """
    aside = len(values) // 4
    kept = slice(aside, len(values) - aside)
    return float(np.partition(values, (kept.start, kept.stop - 1))[kept].mean())


def patient_values(trainings: Sequence[Mapping[str, np.ndarray]]) -> Values:
    """Return the figures of N episodes on patients of R trainings, of their last infos."""
    final = {name: np.stack([each[name] for each in trainings]) for name in trainings[0]}
    success, declared = final["success"] > 0, final["declared"] > 0
    values = {
        "success_declared": success & declared,
        "success_true": success,
        "declared": declared,
        "false_declarations": declared & ~success,
        "reached": final["reached"],
        "seconds": final["seconds"],
        "episode_steps": final["steps"],
        "position_error": final["position_error"] * 1e3,
        "rotation_error": np.degrees(final["rotation_error"]),
        "final_grade": final["score"],
        "return": final["return"],
        "peak_force": final["peak_force"],
        "mean_force": final["mean_force"],
        "violations": final["workspace_hits"] + final["force_hits"],
    }
    values |= {name: final[name] for name in ("arm_hits",) if name in final}
    return {name: each.astype(np.float64) for name, each in values.items()}


def measure_patients(values: Values, units: np.ndarray) -> tuple[Metrics, Evidence]:
    """Return the metrics of N episodes on patients, the (N,) units, and the evidence.

    Of what is skewed, or has to be read with failures included, medians and quartiles as well.
    """
    evidence, metrics = Evidence(), {}
    places = np.arange(len(units))
    for name, each in values.items():
        what = METRICS[name]
        figures = evidence.add(name, what.statistic, each[:, None], places, units)
        metrics[name] = figures.interval(what.least, what.most).to_json(what.unit)
    for name in SPREAD:
        what = METRICS[name]
        figures = evidence.add(f"{name}_median", "median", values[name][:, None], places, units)
        metrics[f"{name}_median"] = figures.interval(what.least, what.most).to_json(what.unit)
        for title, share in QUARTILES.items():
            rows = [
                lambda keep, row=row, share=share: float(np.quantile(row[keep], share))
                for row in values[name]
            ]
            kept = evidence.add_set(f"{name}_{title}", set_replicates(rows, units))
            metrics[f"{name}_{title}"] = kept.interval(what.least, what.most).to_json(what.unit)
    return metrics, evidence


def measure_by_seed(
    values: Values, seeds: Sequence[int], units: np.ndarray | None = None, length: str = "mm"
) -> dict[str, Metrics]:
    """Return the metrics of each start set; the episodes stand in the order of the sets."""
    count = next(iter(values.values())).shape[1]
    own = np.split(np.arange(count) if units is None else units, len(seeds))
    parts = {name: np.split(each, len(seeds), axis=1) for name, each in values.items()}
    rows = range(len(seeds))
    each_set = [{name: part[row] for name, part in parts.items()} for row in rows]
    sets = zip(seeds, each_set, own, strict=True)
    return {str(seed): measure(each, unit, length)[0] for seed, each, unit in sets}


def by_seed_of(evidence: Evidence, seeds: Sequence[int]) -> dict[str, Metrics]:
    """Return the metrics of each start set that follow from the evidence of all episodes.

    Raises:
        ValueError: evidence without the episodes, or of as many as make no such sets.
    """
    values = dict(values_of(evidence))
    if not {"success_true", "episode_steps"} <= values.keys():
        raise ValueError("no success or no steps of each episode")
    # Where a training has no success its steps are not kept, and follow from these.
    steps = np.where(values["success_true"] > 0, values["episode_steps"], np.nan)
    try:
        return measure_by_seed(values | {"steps": steps, "steps_median": steps}, seeds)
    except (KeyError, IndexError) as error:
        raise ValueError(f"no {error}") from error


def values_of(evidence: Evidence) -> Values:
    """Return the figures of episodes that evidence keeps, as they were measured."""
    kept = ((name, evidence.figures[name].values) for name in METRICS if name in evidence.figures)
    return {name: values[:, 0] for name, values in kept if values is not None}


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
    figure = median(np.asarray(times[WARM_UP:]), "ms", resamples)
    figure["settings"] |= {
        "interval": f"percentile bootstrap over decisions, {resamples} resamples",
        "batch": 1,
        "counts": "policy and environment step",
        "threads": torch.get_num_threads(),
        "paper_ms": PAPER_MS,
    }
    return figure
