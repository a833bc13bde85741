"""How good an agent is: its episodes from fixed sets of starts, judged by truth and by grader."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.imaging import ImageSource
from racines_data.world import World
from racines_envs.agents import load_agent, sees
from racines_envs.agents.onnx.policy import OnnxPolicyAgent
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.protocol import Agent
from racines_envs.agents.rollout import Episodes, rollout
from racines_envs.agents.trace import TraceAgent
from racines_envs.evaluation.latency import decision_times, latency_figure
from racines_envs.evaluation.measures import Figures, measure, measure_by_seed
from racines_envs.task.core import ScanCore
from racines_envs.task.rewards import get_reward
from racines_envs.task.starts import evaluation_seeds
from racines_envs.worlds.backends import make_grader
from racines_envs.worlds.making import (
    WorldLike,
    check_grader,
    find_task,
    make_core,
    make_phantom,
    phantom_recipe,
)
from racines_models import statistics
from racines_models.devices import on_device
from racines_models.protocol import Judge

SCHEMA = "racines.agent-scores/1"


@dataclass(frozen=True)
class EvaluationConfig:
    """On what, from where and how an agent is judged."""

    view: str = "SC"
    """The target view."""
    starts: int = 100
    """Episodes from each start set: its first n."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Name the start sets."""
    seed: int | None = None
    """Names one start set, instead of `seeds`."""
    backend: str = "phantom"
    """`phantom`, `generator` or `replay`."""
    generator: str = ""
    """Name, run folder or ONNX file, for the backend `generator`."""
    data: str = ""
    """Dataset folder, for the backend `replay`."""
    reward: str = "oracle"
    """Whose hits end an episode and whose return is reported: `paper`, `oracle` or `shaped`."""
    grader: str = ""
    """Run folder of a grader that judges the last image of each episode; none if empty."""
    latency: int = 60
    """Decisions that are timed one at a time, at least 50; 0 for none (times never repeat)."""
    resamples: int = 2000
    """Bootstrap resamples of each interval."""
    pictured: int = 4
    """Episodes in the picture of trajectories."""
    device: str = "cpu"

    @property
    def sets(self) -> tuple[int, ...]:
        """The start sets in use."""
        return tuple(self.seeds) if self.seed is None else (self.seed,)


@dataclass(frozen=True)
class Evaluation:
    """Scores of one agent, and the episodes they were taken from."""

    scores: dict[str, Any]
    episodes: Episodes
    core: ScanCore
    pictured: int


@dataclass(frozen=True)
class Prepared:
    """An agent before its starts."""

    agent: Agent
    core: ScanCore
    seeds: Tensor
    """(n,) of the starts, set after set."""
    grader: Judge | None


def evaluate(
    name: str,
    run_dir: Path,
    config: EvaluationConfig,
    phantom: WorldLike = None,
    grader: Judge | None = None,
    agent: Agent | None = None,
    run: str | None = None,
    board: str | None = None,
) -> Evaluation:
    """Run the agent that lies in `run_dir` and score it; all episodes of all sets at once.

    Args:
        name: Registered agent, `module:Class`, `FILE.onnx`, or a trace, `FILE.json`.
        run_dir: What its training left; not read for agents without weights.
        config: The evaluation.
        phantom: A phantom or its configuration; the shared default by default.
        grader: Instead of the folder in the config.
        agent: One that is open already, instead of the one that name and folder say.
        run: What the scores call it; the agent's name by default.
        board: The board that the scores are for, if they are for one.

    Raises:
        RacinesError: unknown names, missing weights, an agent that was trained for another view, or
            a trace that was recorded elsewhere.
    """
    began = time.perf_counter()
    config = on_device(config)
    ready = prepare(name, run_dir, config, phantom, grader, agent)
    agent, core, seeds, grader = ready.agent, ready.core, ready.seeds, ready.grader
    episodes = rollout(core, agent, seeds.to(core.device))
    if isinstance(agent, TraceAgent):
        agent.check_ended(episodes)
    steps = reference_steps(config.view, seeds, core.phantom, config.device)
    metrics = measure(episodes, steps, config.resamples)
    if grader is not None:
        metrics |= _graded(core, grader)
    if config.latency and not isinstance(agent, TraceAgent):
        alone = _core(config, agent, core.phantom, grader, 1, core.images)
        times = decision_times(alone, agent, seeds.to(core.device), config.latency)
        metrics["latency"] = latency_figure(times, config.resamples)
    by_seed = measure_by_seed(episodes, steps, config.sets, config.resamples)
    scores = _document(run_dir, config, core, agent, metrics, by_seed)
    scores |= {"extractors": _extractors(agent, grader)}
    scores |= {"agent": run or scores["submission"]} | ({"board": board} if board else {})
    return Evaluation(
        scores | {"seconds": time.perf_counter() - began}, episodes, core, config.pictured
    )


def prepare(
    name: str,
    run_dir: Path,
    config: EvaluationConfig,
    phantom: WorldLike = None,
    grader: Judge | None = None,
    agent: Agent | None = None,
) -> Prepared:
    """Return an agent and the environment that it is judged in; arguments as of `evaluate`."""
    config = on_device(config)
    task = find_task(config.view, phantom)  # an unknown view is refused before anything is loaded
    seeds = start_seeds(config.starts, config.sets)
    agent = agent or load_agent(name, run_dir, config.device)
    check_view(agent, config.view, name, run_dir)
    world = make_phantom(phantom, config.device, task.anatomy)
    if grader is None and config.grader:
        grader = make_grader(config.grader, config.device)
    check_grader(grader, task)
    return Prepared(agent, _core(config, agent, world, grader, len(seeds)), seeds, grader)


def start_seeds(starts: int, sets: Sequence[int]) -> Tensor:
    """Return (sets × starts,) episode seeds, one set after the other.

    Raises:
        RacinesError: no starts, no sets, or a set named twice.
    """
    if starts < 1:
        raise RacinesError(f"evaluation.starts is {starts}: give at least 1")
    whole = all(isinstance(seed, int) and not isinstance(seed, bool) for seed in sets)
    if not sets or not whole or len(set(sets)) != len(sets):
        raise RacinesError(f"evaluation.seeds is {list(sets)}: give different integers")
    return torch.cat([evaluation_seeds(starts, seed) for seed in sets])


def check_view(agent: Agent, view: str, name: str, run_dir: Path) -> None:
    """Check that an agent that was trained for a view is asked for that one.

    Raises:
        RacinesError: it was trained for another.
    """
    trained = getattr(agent, "view", view)
    if trained != view:
        raise RacinesError(
            f"{run_dir}: this policy was trained for {trained}, not {view}: train one with "
            f"`racines train agent {name} --view {view}`, or evaluate --view {trained}"
        )


def _core(
    config: EvaluationConfig,
    agent: Agent,
    phantom: World,
    grader: Judge | None,
    rows: int,
    images: ImageSource | None = None,
) -> ScanCore:
    """Return the environment; with `images`, what draws them is not loaded again."""
    return make_core(
        config.view,
        rows,
        backend=images or config.backend,
        generator=config.generator or None,
        observation=agent.observation,
        reward=config.reward,
        phantom=phantom,
        grader=grader if get_reward(config.reward).needs_judge else None,
        device=config.device,
        encoder=getattr(agent, "encoder", None),
        data=config.data or None,
    )


def reference_steps(view: str, seeds: Tensor, phantom: World, device: str) -> np.ndarray:
    """Return the planner's (n,) steps from the same starts, the l of SPL."""
    core = make_core(
        view, len(seeds), observation="params", reward="oracle", phantom=phantom, device=device
    )
    return rollout(core, PlannerAgent(), seeds.to(core.device)).final["steps"]


def _graded(core: ScanCore, grader: Judge) -> Figures:
    """Ask the grader about the last image of each episode."""
    p, g = grader.probabilities_and_grade(core.picture())
    hit = (p[:, core.task.target] >= core.rewards.probability) & (g >= core.rewards.grade)
    return {"success_grader": statistics.wilson(hit.cpu().numpy())}


def _extractors(agent: Agent, grader: Judge | None) -> dict[str, dict[str, Any]]:
    """Return the settings of the graders that had a say, with their hashes.

    `grader` judged the last images; `guide` is the one whose opinion the agent went by.
    """
    graders = {"grader": grader, "guide": getattr(agent, "guide", None)}
    told = {kind: each.settings for kind, each in graders.items() if each is not None}
    return {kind: settings for kind, settings in told.items() if settings is not None}


def _document(
    run_dir: Path,
    config: EvaluationConfig,
    core: ScanCore,
    agent: Agent,
    metrics: Figures,
    by_seed: dict[str, Figures],
) -> dict[str, Any]:
    from racines_models.provenance import code_version, environment, weights_sha256

    task = core.task
    weights = weights_sha256(run_dir) if hasattr(agent, "view") and run_dir.is_dir() else {}
    if isinstance(agent, (OnnxPolicyAgent, TraceAgent)):
        weights = {agent.path.name: agent.sha256}
    return {
        "schema": SCHEMA,
        "agent": agent.name,
        "submission": agent.name,
        "sees": sees(agent),
        "task": {
            "view": task.view,
            "backend": config.backend,
            "observation": getattr(agent, "seen", agent.observation),
            "reward": config.reward,
            "start_set": {"seeds": list(config.sets), "starts": config.starts},
            "definition": asdict(task),
        },
        "phantom": phantom_recipe(core.phantom),
        "metrics": metrics,
        "by_seed": by_seed,
        "seeds": list(config.sets),
        "weights": _named(weights),
        "code": code_version(),
        "environment": environment(str(core.device)),
    }


def _named(weights: dict[str, str]) -> dict[str, Any] | None:
    if not weights:
        return None
    only = next(iter(weights.values())) if len(weights) == 1 else None
    return {"sha256": weights.get("policy.safetensors", only), "files": weights}


def write_evaluation(evaluation: Evaluation, scores: Path, picture: Path | None) -> None:
    """Write the scores JSON and, where wanted, the picture of trajectories."""
    from racines_data.files import write_json

    write_json(scores, evaluation.scores)
    if picture is not None:
        from racines_envs.evaluation.pictures import draw_trajectories

        draw_trajectories(evaluation, picture)
