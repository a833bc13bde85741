"""How good an agent is: its episodes from fixed sets of starts, judged by truth and by grader."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from racines_data.engines import Engine
from racines_data.errors import RacinesError
from racines_data.world import World
from racines_envs.agents import learns, load_agent
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.protocol import FILES, Agent, acts, encoder_of
from racines_envs.agents.rollout import Episodes, join_episodes, rollout
from racines_envs.agents.trace import (
    TraceAgent,
    check_traceable,
    circumstances,
    read_trace,
    write_trace,
)
from racines_envs.evaluation.agent_specs import check_view
from racines_envs.evaluation.measures import episode_values, latency, measure, measure_by_seed
from racines_envs.evaluation.told import carried_by, extractors_of, shown_to, told_of_agent
from racines_envs.evaluation.trainings import Training, find_trainings, given_trainings
from racines_envs.robots.arm import FREE
from racines_envs.task.core import ScanCore
from racines_envs.task.rewards import get_reward
from racines_envs.task.starts import evaluation_seeds
from racines_envs.task.tasks import Task
from racines_envs.worlds.backends import check_grader, make_grader
from racines_envs.worlds.making import WorldLike, find_task, make_core, make_phantom, phantom_recipe
from racines_envs.worlds.recorded.world import Recordings
from racines_models.devices import on_device
from racines_models.protocol import Judge
from racines_models.statistics import Evidence, write_scores

SCHEMA = "racines.agent-scores/1"


@dataclass(frozen=True)
class StudyConfig:
    """From where agents are let act, and how exactly they are told apart."""

    view: str = ""
    """The target view; that of the agents if empty."""
    starts: int = 100
    """Episodes from each start set: its first n."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Name the start sets."""
    resamples: int = 2000
    """Bootstrap resamples of times and of correlations."""
    device: str = "cpu"

    @property
    def sets(self) -> tuple[int, ...]:
        """The start sets in use."""
        return tuple(self.seeds)

    @property
    def start_set(self) -> dict[str, Any]:
        """The starts, as documents name them."""
        return {"seeds": list(self.sets), "starts": self.starts}


@dataclass(frozen=True)
class EvaluationConfig(StudyConfig):
    """On what, from where and how an agent is judged."""

    view: str = "SC"
    """The target view."""
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
    pictured: int = 4
    """Episodes in the picture of trajectories."""
    robot: str = FREE
    """`free`, or the arm that carries the probe: `ur5e`, another's name, `module:ARM`."""

    @property
    def sets(self) -> tuple[int, ...]:
        """The start sets in use."""
        return super().sets if self.seed is None else (self.seed,)


@dataclass(frozen=True)
class Scored:
    """Scores of one agent, and what they follow from."""

    scores: dict[str, Any]
    evidence: Evidence


@dataclass(frozen=True)
class Evaluation(Scored):
    """Scores on the one heart, and the episodes of the agent's first training."""

    episodes: Episodes
    core: ScanCore
    pictured: int


class Prepared(NamedTuple):
    """An agent before its starts."""

    agent: Agent
    core: ScanCore
    seeds: Tensor
    """(n,) of the starts, set after set."""
    grader: Judge | None


def evaluate(
    name: str, run_dir: Path, config: EvaluationConfig, phantom: WorldLike = None,
    grader: Judge | None = None, agent: Agent | None = None, run: str | None = None,
    board: str | None = None, published: Path | None = None, engine: Engine | None = None,
    further: Sequence[Agent] = (),
) -> Evaluation:  # fmt: skip
    """Run the agent that lies in `run_dir` and score it; all episodes of all sets at once.

    Each of its trainings (see `trainings`) acts from the same starts, one after the other; those in
    the folder `published` count as well.

    `name` is a registered agent, `module:Class`, `FILE.onnx`, or a trace, `FILE.json`; `run_dir`,
    what its training left, is not read for agents without weights. A `phantom` is the shared one by
    default; a `grader` and an `agent` that are open already stand for those that settings and name
    say, the agent for one training, and `further` for more of the same method, seeds 1 and up. The
    scores call it `run`, or else by the agent's name, and tell
    the `board` they are for. With an `engine` that is started, each training acts from each start
    set in a task of its own.

    Raises:
        RacinesError: unknown names, missing weights, an agent that was trained for another view,
            trainings that do not belong together, or a trace that was recorded elsewhere.
    """
    began = time.perf_counter()
    config = on_device(config)
    trainings = [Training(Path(run_dir))]
    given = agent is not None or Path(name).suffix.lower() in FILES
    agent, core, seeds, grader = prepare(name, run_dir, config, phantom, grader, agent)
    if learns(agent) and not given:
        trainings = find_trainings(run_dir, published)
    others = [load_agent(name, each.folder, config.device) for each in trainings[1:]]
    if further:
        trainings, others = given_trainings(agent, further, Path(run_dir)), [*further]
    for training, other in zip(trainings[1:], others, strict=True):
        check_view(other, config.view, name, training.folder)
    if engine is None or isinstance(agent, TraceAgent):  # a trace is of all starts at once
        acted = [_act(agent, core, seeds, grader)]
        for other in others:
            acted.append(_act(other, _alike(core, other, config, len(seeds)), seeds, grader))
    else:
        acted = act_by_sets(engine, [agent, *others], config, phantom, grader)
    steps = reference_steps(config.view, seeds, core.phantom, config.device)
    values = episode_values([episodes for episodes, _ in acted], steps)
    if grader is not None:
        values = {**values, "success_grader": np.stack([hits for _, hits in acted])}
    told = units_of(core, acted[0][0])
    metrics, evidence = measure(values, *told)
    if config.latency and not isinstance(agent, TraceAgent):
        alone = _alike(core, agent, config, 1)
        timed = latency(alone, agent, seeds.to(core.device), config.latency, config.resamples)
        metrics["latency"] = timed
    by_seed = measure_by_seed(values, config.sets, *told)
    scores = _document(trainings, config, core, agent, {"metrics": metrics, "by_seed": by_seed})
    scores |= {"extractors": extractors_of(agent, grader), "agent": run or agent.name}
    scores |= {"board": board} if board else {}
    scores["seconds"] = time.perf_counter() - began
    return Evaluation(scores, evidence, acted[0][0], core, config.pictured)


def act_by_sets(
    engine: Engine, agents: Sequence[Agent], config: EvaluationConfig, phantom: WorldLike,
    grader: Judge | None,
) -> list[tuple[Episodes, np.ndarray]]:  # fmt: skip
    """Return what `_act` does of every agent from all start sets, a task an agent and set."""
    tasks = [(place, seed) for place in range(len(agents)) for seed in config.sets]
    state = agents, config, phantom, grader
    made = list(engine.map(_act_in_set, state, tasks, threads=None))
    of_each = [made[k : k + len(config.sets)] for k in range(0, len(made), len(config.sets))]
    return [
        (
            join_episodes([episodes for episodes, _ in own]),
            np.concatenate([hits for _, hits in own]),
        )
        for own in of_each
    ]


def _act_in_set(
    state: tuple[Sequence[Agent], EvaluationConfig, WorldLike, Judge | None], task: tuple[int, int]
) -> tuple[Episodes, np.ndarray]:
    agents, config, phantom, grader = state
    one = replace(config, seed=task[1])
    return _act(*prepare("", Path(), one, phantom, grader, agents[task[0]]))


def _act(
    agent: Agent, core: ScanCore, seeds: Tensor, grader: Judge | None
) -> tuple[Episodes, np.ndarray]:
    """Return an agent's n episodes, and (n,) whether the grader sees a hit in the last images."""
    episodes = rollout(core, agent, seeds.to(core.device))
    if isinstance(agent, TraceAgent):
        agent.check_ended(episodes)
    if grader is None:
        return episodes, np.full(len(seeds), np.nan)
    p, g = grader.probabilities_and_grade(core.picture())
    hit = (p[:, core.task.target] >= core.rewards.probability) & (g >= core.rewards.grade)
    return episodes, hit.cpu().numpy().astype(np.float64)


def _alike(core: ScanCore, agent: Agent, config: EvaluationConfig, rows: int) -> ScanCore:
    """Return another environment of the same; what draws its images is not loaded again."""
    return core_for(
        agent, config.view, rows, backend=core.images, reward=core.reward, phantom=core.phantom,
        grader=core.grader, device=config.device, robot=config.robot,
    )  # fmt: skip


def prepare(
    name: str, run_dir: Path, config: EvaluationConfig, phantom: WorldLike = None,
    grader: Judge | None = None, agent: Agent | None = None,
) -> Prepared:  # fmt: skip
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
    core = core_for(
        agent, config.view, len(seeds), backend=config.backend,
        generator=config.generator or None, data=config.data or None, reward=config.reward,
        grader=grader if get_reward(config.reward).needs_judge else None, phantom=world,
        device=config.device, robot=config.robot,
    )  # fmt: skip
    return Prepared(agent, core, seeds, grader)


def record_trace(
    name: str, run_dir: Path, config: EvaluationConfig, path: Path, phantom: WorldLike = None,
    grader: Judge | None = None, agent: Agent | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Let an agent act from the starts that it is judged on, and write what it did to a file.

    All but `path` is as of `evaluate`; what comes back is that path, and counts.
    """
    agent, core, seeds, _ = prepare(name, run_dir, config, phantom, grader, agent)
    check_traceable(agent)
    episodes = rollout(core, agent, seeds.to(core.device))
    told = {"agent": agent.name, "observation": shown_to(agent), "start_set": config.start_set}
    told |= circumstances(core, config.backend)
    count, steps = write_trace(path, told, [episodes])
    read_trace(path)
    return {"out": str(path), "episodes": count, "steps": steps}


def start_seeds(starts: int, sets: Sequence[int]) -> Tensor:
    """Return (sets × starts,) episode seeds, one set after the other; none may be named twice."""
    if starts < 1:
        raise RacinesError(f"evaluation.starts is {starts}: give at least 1")
    whole = all(isinstance(seed, int) and not isinstance(seed, bool) for seed in sets)
    if not sets or not whole or len(set(sets)) != len(sets):
        raise RacinesError(f"evaluation.seeds is {list(sets)}: give different integers")
    return torch.cat([evaluation_seeds(starts, seed) for seed in sets])


def core_for(agent: Agent, view: str | Task, rows: int, **settings: Any) -> ScanCore:
    """Return the environment of a view as an agent looks at it; settings as of `make_core`."""
    shown: dict[str, Any] = {"observation": agent.observation, "encoder": encoder_of(agent)}
    return make_core(view, rows, action=acts(agent), **shown, **settings)


def reference_steps(view: str, seeds: Tensor, phantom: World, device: str) -> np.ndarray:
    """Return the planner's (n,) steps from the same starts with a free probe, the l of SPL."""
    core = make_core(
        view, len(seeds), observation="params", reward="oracle", phantom=phantom, device=device
    )
    return rollout(core, PlannerAgent(), seeds.to(core.device)).final["steps"]


def units_of(core: ScanCore, episodes: Episodes) -> tuple[np.ndarray | None, str]:
    """Return what n episodes are independent in, (n,), and in what their lengths are told.

    In recordings that stand alone it is the trajectory that an episode starts in; else its start.
    """
    if not isinstance(core.phantom, Recordings):
        return None, "mm"
    return core.phantom.start_units(episodes.seeds).numpy(), core.phantom.unit


def _document(
    trainings: Sequence[Training], config: EvaluationConfig, core: ScanCore, agent: Agent,
    figures: dict[str, Any],
) -> dict[str, Any]:  # fmt: skip
    return {
        "schema": SCHEMA,
        **told_of_agent(agent, trainings, core.device),
        "task": {
            "view": core.task.view,
            "backend": config.backend,
            "observation": shown_to(agent),
            "reward": config.reward,
            "start_set": config.start_set,
            "definition": core.task.definition,
            **carried_by(config.robot),
        },
        "phantom": phantom_recipe(core.phantom),
        **figures,
        "seeds": list(config.sets),
    }


def write_evaluation(
    evaluation: Scored, scores: Path, picture: Path | None, force: bool = True
) -> None:
    """Write the scores JSON, the evidence beside it (.parquet) and, where wanted, the picture.

    On patients there is none.

    The scores name the evidence by its hash, which they are given here.

    Raises:
        RacinesError: without `force`, another result is there, or a file that is no evidence of it.
    """
    evaluation.scores.update(write_scores(scores, evaluation.scores, evaluation.evidence, force))
    if picture is not None and isinstance(evaluation, Evaluation):
        from racines_envs.evaluation.pictures import draw_trajectories

        draw_trajectories(evaluation, picture)
