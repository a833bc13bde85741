"""The transfer matrix: agents, each in every backend, and whether backends rank them alike.

Whatever draws the images and wherever an agent was trained, the phantom's truth judges; but
recordings of no phantom have only their own labels, and the document says so.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from racines_data.errors import RacinesError
from racines_envs.agents.rollout import rollout
from racines_envs.evaluation.agent_specs import Run, common_view
from racines_envs.evaluation.measures import path_length_score
from racines_envs.evaluation.run import check_view, reference_steps, start_seeds
from racines_envs.studies.transfer.rank_correlation import correlate
from racines_envs.worlds.making import WorldLike, find_task, make_core, make_phantom, phantom_recipe
from racines_envs.worlds.recorded_world import RecordedWorld
from racines_models import statistics
from racines_models.devices import on_device

SCHEMA = "racines.agent-transfer/1"
COMPARED = ("success_true", "episode_steps", "spl", "final_grade")


@dataclass(frozen=True)
class TransferConfig:
    """Which starts, and how exactly."""

    view: str = ""
    """The target view; that of the agents if empty."""
    starts: int = 100
    """Episodes from each start set."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Name the start sets."""
    resamples: int = 2000
    """Bootstrap resamples of each interval."""
    device: str = "cpu"


def backend_arguments(spec: str) -> dict[str, Any]:
    """Return what `make_core` needs for `phantom`, `generator:NAME` or `replay:FOLDER`.

    Raises:
        RacinesError: another kind, or one without what it needs.
    """
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

    Raises:
        RacinesError: unknown backends, agents of different views, or artefacts that are not there.
    """
    if len(set(backends)) != len(backends) or not backends:
        raise RacinesError(f"backends are {', '.join(backends) or 'none'}: name each once")
    config = on_device(config)
    arguments = [backend_arguments(backend) for backend in backends]
    seeds, view = start_seeds(config.starts, config.seeds), common_view(runs, config.view)
    phantom = make_phantom(phantom, config.device, find_task(view, phantom).anatomy)
    shortest = reference_steps(view, seeds, phantom, config.device)
    finals: dict[tuple[str, str], dict[str, np.ndarray]] = {}
    judges: dict[str, str] = {}
    for backend, given in zip(backends, arguments, strict=True):
        images = None
        for run in runs:
            agent = run.load(config.device)
            check_view(agent, view, run.agent, run.folder)
            drawn_by: dict[str, Any] = given if images is None else {"backend": images}
            core = make_core(
                view,
                len(seeds),
                **drawn_by,
                observation=agent.observation,
                reward="oracle",
                phantom=phantom,
                encoder=getattr(agent, "encoder", None),
                device=config.device,
            )
            images = core.images  # loaded once for all agents
            recorded = isinstance(core.phantom, RecordedWorld)
            judges[backend] = "the recorded labels" if recorded else "the phantom's truth"
            final = rollout(core, agent, seeds.to(core.device)).final
            alone = (
                core.phantom is not phantom
            )  # recordings of no phantom, with starts of their own
            steps = reference_steps(view, seeds, core.phantom, config.device) if alone else shortest
            finals[run.label, backend] = _scores(final, steps)
    return {
        "schema": SCHEMA,
        "view": view,
        "start_set": {"seeds": list(config.seeds), "starts": config.starts},
        "phantom": phantom_recipe(phantom),
        "agents": [_describe(run) for run in runs],
        "backends": list(backends),
        "judged_by": judges,
        "cells": [
            {"agent": run.label, "backend": backend}
            | {"metrics": _figures(finals[run.label, backend], config.resamples)}
            for run in runs
            for backend in backends
        ],
        "correlations": _correlations(runs, backends, finals, config.resamples),
    }


def _scores(final: dict[str, np.ndarray], shortest: np.ndarray) -> dict[str, np.ndarray]:
    """Return (n,) of each compared figure."""
    success, steps = final["success"], final["steps"]
    return {
        "success_true": success,
        "episode_steps": steps,
        "spl": path_length_score(success, steps, shortest),
        "final_grade": final["grade"],
    }


def _figures(scores: dict[str, np.ndarray], resamples: int) -> dict[str, Any]:
    success, steps = scores["success_true"], scores["episode_steps"]
    return {
        "success_true": statistics.wilson(success),
        "steps": statistics.mean(
            steps[success], "steps of the episodes with true success", resamples
        ),
        "episode_steps": statistics.mean(steps, "steps", resamples),
        "spl": statistics.mean(scores["spl"], None, resamples),
        "final_grade": statistics.mean(scores["final_grade"], None, resamples),
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
    runs: Sequence[Run],
    backends: Sequence[str],
    finals: dict[tuple[str, str], dict[str, np.ndarray]],
    resamples: int,
) -> list[dict[str, Any]]:
    found = []
    if len(runs) < 2:
        return found
    for first, second in combinations(backends, 2):
        for figure in COMPARED:
            x, y = (
                np.stack([finals[run.label, backend][figure] for run in runs]).astype(np.float64)
                for backend in (first, second)
            )
            pair = {"backends": [first, second], "figure": figure}
            found.append(pair | correlate(x, y, resamples))
    return found
