"""How good an agent is: its episodes from a fixed set of starts, judged by truth and by grader."""

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from racines_data.errors import RacinesError
from racines_envs import intervals
from racines_envs.agents import agent_class, load_agent
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.protocol import Agent
from racines_envs.backends import make_grader
from racines_envs.core import ScanCore
from racines_envs.making import check_grader, find_task, make_core, make_phantom, phantom_recipe
from racines_envs.rollout import Episodes, rollout
from racines_envs.starts import evaluation_seeds

SCHEMA = "racines.agent-scores/1"
RETURN_OF_A_HIT = 50.0


@dataclass(frozen=True)
class EvaluationConfig:
    """On what, from where and how an agent is judged."""

    view: str = "SC"
    """The target view."""
    starts: int = 100
    """Episodes; the first n of the fixed start set."""
    seed: int = 0
    """Names the start set."""
    backend: str = "phantom"
    """`phantom` or `generator`."""
    generator: str = ""
    """Name or run folder, for the backend `generator`."""
    reward: str = "oracle"
    """Whose hits end an episode and whose return is reported: `paper`, `oracle` or `shaped`."""
    grader: str = ""
    """Run folder of a grader that judges the last image of each episode; none if empty."""
    resamples: int = 2000
    """Bootstrap resamples of each interval."""
    pictured: int = 4
    """Episodes in the picture of trajectories."""
    device: str = "cpu"


@dataclass(frozen=True)
class Evaluation:
    """Scores of one agent, and the episodes they were taken from."""

    scores: dict[str, Any]
    episodes: Episodes
    core: ScanCore
    pictured: int


def evaluate(
    name: str, run_dir: Path, config: EvaluationConfig, phantom: Any = None, grader: Any = None
) -> Evaluation:
    """Run the agent that lies in `run_dir` and score it.

    Args:
        name: Registered agent, or `module:Class`.
        run_dir: What its training left; not read for agents without weights.
        config: The evaluation.
        phantom: A phantom or its configuration; the shared default by default.
        grader: Instead of the folder in the config.

    Raises:
        RacinesError: unknown names, missing weights, or an agent that was trained for another view.
    """
    began = time.perf_counter()
    task = find_task(config.view, phantom)  # an unknown view is refused before anything is loaded
    if config.starts < 1:
        raise RacinesError(f"evaluation.starts is {config.starts}: give at least 1")
    agent = load_agent(name, run_dir, config.device)
    trained = getattr(agent, "view", config.view)
    if trained != config.view:
        raise RacinesError(
            f"{run_dir}: this policy was trained for {trained}, not {config.view}: train one with "
            f"`racines train agent {name} --view {config.view}`, or evaluate --view {trained}"
        )
    phantom = make_phantom(phantom, config.device, task.anatomy)
    if grader is None and config.grader:
        grader = make_grader(config.grader, config.device)
    check_grader(grader, task)
    core = _core(config, agent.observation, phantom, grader)
    seeds = evaluation_seeds(config.starts, config.seed).to(core.device)
    episodes = rollout(core, agent, seeds)
    metrics = measure(episodes, _reference_steps(config, phantom), config.resamples)
    if grader is not None:
        metrics |= _graded(core, episodes, grader)
    scores = _document(name, run_dir, config, core, agent, metrics)
    return Evaluation(
        scores | {"seconds": time.perf_counter() - began}, episodes, core, config.pictured
    )


def _core(config: EvaluationConfig, observation: str, phantom: Any, grader: Any) -> ScanCore:
    return make_core(
        config.view,
        config.starts,
        backend=config.backend,
        generator=config.generator or None,
        observation=observation,
        reward=config.reward,
        phantom=phantom,
        grader=grader if config.reward == "paper" else None,
        device=config.device,
    )


def _reference_steps(config: EvaluationConfig, phantom: Any) -> np.ndarray:
    """Return the planner's (n,) steps from the same starts, the shortest way of SPL."""
    core = make_core(
        config.view, config.starts, observation="params", reward="oracle", phantom=phantom,
        device=config.device,
    )  # fmt: skip
    seeds = evaluation_seeds(config.starts, config.seed).to(core.device)
    return rollout(core, PlannerAgent(), seeds).final["steps"]


def measure(
    episodes: Episodes, reference_steps: np.ndarray, resamples: int = 2000
) -> dict[str, dict[str, Any]]:
    """Return the figures of n episodes.

    SPL is the mean of success × l / max(l, steps) (Anderson et al., On Evaluation of Embodied
    Navigation Agents, 2018) with l the oracle planner's steps from the same start.
    """
    final = episodes.final
    success, steps = final["success"], final["steps"]
    spl = success * reference_steps / np.maximum(reference_steps, np.maximum(steps, 1))
    violations = final["workspace_hits"] + final["force_hits"]
    farmed = (final["return"] >= RETURN_OF_A_HIT) & ~success

    def mean(values: np.ndarray, unit: str | None = None) -> dict[str, Any]:
        return intervals.mean(values, unit, resamples)

    figures = {
        "success_true": intervals.wilson(success),
        "success_graded": intervals.wilson(final["success_graded"]),
        "steps": mean(steps[success], "steps of the episodes with true success"),
        "steps_median": intervals.median(steps[success], "steps", resamples),
        "episode_steps": mean(steps, "steps"),
        "spl": mean(spl),
        "final_grade": mean(final["grade"]),
        "return": mean(final["return"]),
        "peak_force": mean(final["peak_force"], "N"),
        "mean_force": mean(final["mean_force"], "N"),
        "violations": mean(violations, "refused steps an episode"),
        "position_error": mean(final["position_error"] * 1e3, "mm"),
        "rotation_error": mean(np.degrees(final["rotation_error"]), "degrees"),
        "return_without_success": intervals.wilson(farmed),
    }
    for name, values in (
        ("spl", spl),
        ("final_grade", final["grade"]),
        ("return", final["return"]),
    ):
        figures[f"{name}_iqm"] = intervals.interquartile_mean(values, None, resamples)
    return figures


def _graded(core: ScanCore, episodes: Episodes, grader: Any) -> dict[str, dict[str, Any]]:
    """Ask the grader about the last image of each episode."""
    p, g = grader.probabilities_and_grade(core.picture())
    hit = (p[:, core.task.target] >= core.rewards.probability) & (g >= core.rewards.grade)
    return {"success_grader": intervals.wilson(hit.cpu().numpy())}


def _document(
    name: str,
    run_dir: Path,
    config: EvaluationConfig,
    core: ScanCore,
    agent: Agent,
    metrics: dict[str, Any],
) -> dict[str, Any]:
    from racines_models.provenance import code_version, environment, weights_sha256

    task = core.task
    weights = weights_sha256(run_dir) if hasattr(agent, "view") and run_dir.is_dir() else {}
    return {
        "schema": SCHEMA,
        "agent": agent_class(name).name,
        "task": {
            "view": task.view,
            "backend": config.backend,
            "observation": agent.observation,
            "reward": config.reward,
            "start_set": {"seed": config.seed, "starts": config.starts},
            "definition": asdict(task),
        },
        "phantom": phantom_recipe(core.phantom),
        "metrics": metrics,
        "seeds": [config.seed],
        "weights": {"sha256": weights["policy.safetensors"]} if weights else None,
        "code": code_version(),
        "environment": environment(str(core.device)),
    }


def write_evaluation(evaluation: Evaluation, scores: Path, picture: Path | None) -> None:
    """Write the scores JSON and, where wanted, the picture of trajectories."""
    from racines_data.files import write_json

    write_json(scores, evaluation.scores)
    if picture is not None:
        from racines_envs.pictures import draw_trajectories

        draw_trajectories(evaluation, picture)
