"""Why an agent moved as it did: attributions along episodes, scored, and beside the truth."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose
from racines_envs.agents import load_agent
from racines_envs.explain.explanation import Explanation, Shown
from racines_envs.explain.figure import draw_episode
from racines_envs.explain.maps import (
    Explained,
    grader_probabilities,
    integrated_gradients,
    outputs,
    policy_logits,
)
from racines_envs.explain.scores import SMOOTH, areas, overlap, random_maps
from racines_envs.explain.truth import sector_of, true_regions
from racines_envs.task.core import ScanCore
from racines_envs.task.rewards import get_reward
from racines_envs.task.starts import evaluation_seeds
from racines_envs.worlds.making import WorldLike, find_task, make_core, phantom_recipe
from racines_models import statistics
from racines_models.devices import on_device
from racines_models.protocol import Judge

SCHEMA = "racines.explanation/1"


@dataclass(frozen=True)
class ExplainConfig:
    """What is explained, and how it is scored."""

    view: str = "SC"
    """The target view."""
    starts: int = 10
    """Episodes, the first n of the evaluation's start set."""
    seed: int = 0
    """Names the start set."""
    every: int = 3
    """Steps between the images that are explained; the paper's figure has every third."""
    frames: int = 12
    """Most images an episode, its first; 0 for all."""
    steps: int = 50
    """Points of the integral."""
    random_maps: int = 5
    """Random maps of each kind, of seeds 0, 1, …, that the attributions are compared with."""
    backend: str = "phantom"
    """`phantom`, `generator` or `replay`."""
    generator: str = ""
    """Name, run folder or ONNX file, for the backend `generator`."""
    data: str = ""
    """Dataset folder, for the backend `replay`."""
    reward: str = "oracle"
    """Whose hits end an episode."""
    grader: str = ""
    """Run folder of a grader that is explained beside the policy; none if empty."""
    resamples: int = 2000
    """Bootstrap resamples of each interval."""
    device: str = "cpu"


def explain(
    name: str,
    run_dir: Path,
    config: ExplainConfig,
    phantom: WorldLike = None,
    grader: Judge | None = None,
) -> Explanation:
    """Explain the agent that lies in `run_dir`.

    Args:
        name: Registered agent, or `module:Class`.
        run_dir: What its training left.
        config: The explanation.
        phantom: A phantom or its configuration; the shared default by default.
        grader: Instead of the folder in the config.

    Raises:
        RacinesError: an agent that looks at no image, or has no gradients, or was trained for
            another view; unknown names; missing weights.
    """
    from racines_envs.evaluation.run import check_view
    from racines_envs.worlds.backends import make_grader

    _check(config)
    config = on_device(config)
    task = find_task(config.view, phantom)
    agent = load_agent(name, run_dir, config.device)
    check_view(agent, config.view, name, run_dir)
    judge = policy_logits(agent)
    if grader is None and config.grader:
        grader = make_grader(config.grader, config.device)
    core = make_core(
        config.view,
        config.starts,
        backend=config.backend,
        generator=config.generator or None,
        observation=agent.observation,
        reward=config.reward,
        phantom=phantom,
        data=config.data or None,
        grader=grader if get_reward(config.reward).needs_judge else None,
        device=config.device,
    )
    frames = collect(core, agent, evaluation_seeds(config.starts, config.seed), config)
    judges = {"policy": (judge, frames.actions, True)}
    if grader is not None:
        target = torch.full_like(frames.actions, task.target)
        judges["grader"] = (grader_probabilities(grader), target, False)
    sector = sector_of(core.phantom)
    # A recorded frame is of another pose, near by: what lies under its pixels is not known.
    recorded = config.backend == "replay"
    truth = {} if recorded else true_regions(core.phantom, frames.pose, config.view)
    regions = {region: inside & sector for region, inside in truth.items()}
    maps, probabilities, metrics = {}, {}, {}
    for what, (function, targets, logits) in judges.items():
        made = _attribute(function, frames, targets, logits, config)
        maps[what], probabilities[what], error = made
        scored = _score(function, frames, targets, logits, maps[what], core, config)
        metrics[what] = scored | error | _overlaps(maps[what], frames, regions, core, config)
    scores = _document(name, Path(run_dir), config, core, frames, metrics)
    return Explanation(scores, frames, maps, regions, probabilities)


def _check(config: ExplainConfig) -> None:
    for field in ("starts", "every", "steps", "random_maps"):
        if getattr(config, field) < 1:
            raise RacinesError(f"explain.{field} is {getattr(config, field)}: give at least 1")


@torch.no_grad()
def collect(core: ScanCore, agent: Any, seeds: Tensor, config: ExplainConfig) -> Shown:
    """Let the agent act from (n,) seeds, and keep every so many steps what it saw and did."""
    agent.attach(core)
    observation = core.reset(seeds.to(core.device))
    kept: list[tuple[Tensor, ...]] = []
    last = config.every * (config.frames or core.task.max_steps)
    for step in range(min(core.task.max_steps, last)):
        live = (~core.state.done).nonzero().squeeze(1)
        if len(live) == 0:
            break
        action = agent.act(observation, core.decision_seeds())
        if step % config.every == 0:
            params = observation.get("params", torch.zeros(core.num_envs, 9, device=core.device))
            seen = (observation["image"], params, *core.state.pose, action)
            rows = (live, torch.full_like(live, step))
            kept.append((*(x[live].clone() for x in seen), *rows))
        observation = core.step(action).observation
    images, params, position, rotation, actions, row, step = (
        torch.cat(column) for column in zip(*kept, strict=True)
    )
    return Shown(images, params, Pose(position, rotation), actions, row, step)


def _attribute(
    judge: Explained, frames: Shown, targets: Tensor, logits: bool, config: ExplainConfig
) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """Return attributions, the probability of each target, and the completeness error."""
    maps, error = integrated_gradients(judge, frames.images, frames.params, targets, config.steps)
    full = outputs(judge, frames.images, frames.params)
    black = outputs(judge, torch.zeros_like(frames.images), frames.params)
    change = (full - black).gather(1, targets.unsqueeze(1)).squeeze(1).abs()
    relative = (error.abs() / change.clamp_min(1e-6)).cpu().numpy()
    found = full.softmax(-1) if logits else full
    unit = "|sum of the attributions - change of the output| / change"
    figure = {"completeness_error": statistics.median(relative, unit, config.resamples)}
    return maps, found.gather(1, targets.unsqueeze(1)).squeeze(1), figure


def _score(
    judge: Explained, frames: Shown, targets: Tensor, logits: bool, maps: Tensor, core: ScanCore,
    config: ExplainConfig,
) -> dict[str, Any]:  # fmt: skip
    """Return deletion and insertion of the maps, of random ones, and the differences."""
    sector = sector_of(core.phantom).to(maps.device)
    figures: dict[str, Any] = {}
    for name, insert in (("deletion", False), ("insertion", True)):

        def area(drawn: Tensor, insert: bool = insert) -> np.ndarray:
            return areas(
                judge, frames.images, frames.params, targets, drawn, sector, insert, logits
            )

        own = area(maps)
        figures[name] = _mean(own, frames, config)
        for kind, sigma in (("random", 0.0), ("smooth_random", SMOOTH)):
            noise = [
                area(random_maps(maps.shape, seed, sigma).to(maps.device))
                for seed in range(config.random_maps)
            ]
            figures[f"{name}_{kind}"] = _mean(np.mean(noise, 0), frames, config)
            better = (np.mean(noise, 0) - own) * (-1 if insert else 1)
            figures[f"{name}_gain_over_{kind}"] = _mean(better, frames, config)
    return figures


def _overlaps(
    maps: Tensor,
    frames: Shown,
    regions: dict[str, Tensor],
    core: ScanCore,
    config: ExplainConfig,
) -> dict[str, Any]:
    """Return where the top tenth of the pixels by magnitude lies, and what chance would give."""
    figures: dict[str, Any] = {}
    for name, region in regions.items():
        hit, chance = overlap(maps.abs().cpu(), region, sector_of(core.phantom))
        figures[f"overlap_{name}"] = _mean(hit, frames, config)
        figures[f"overlap_{name}_by_chance"] = _mean(chance, frames, config)
        figures[f"overlap_{name}_gain"] = _mean(hit - chance, frames, config)
    return figures


def _mean(values: np.ndarray, frames: Shown, config: ExplainConfig) -> dict[str, Any]:
    """Return the mean over episodes of their mean images: images of one episode are alike."""
    row = frames.row.cpu().numpy()
    episodes = np.array([values[row == r].mean() for r in np.unique(row)])
    return statistics.mean(episodes, None, config.resamples) | {"images": len(values)}


def _document(
    name: str, run_dir: Path, config: ExplainConfig, core: ScanCore, frames: Shown,
    metrics: dict[str, Any],
) -> dict[str, Any]:  # fmt: skip
    from racines_envs.agents import agent_class
    from racines_models.provenance import code_version, environment, weights_sha256

    return {
        "schema": SCHEMA,
        "agent": agent_class(name).name,
        "settings": asdict(config),
        "method": "Integrated Gradients, Gauss-Legendre, black baseline",
        "phantom": phantom_recipe(core.phantom),
        "images": len(frames.images),
        "metrics": metrics,
        "weights": weights_sha256(run_dir) if run_dir.is_dir() else {},
        "code": code_version(),
        "environment": environment(str(core.device)),
    }


def write_explanation(explanation: Explanation, folder: Path, pictures: int = 4) -> None:
    """Write `explanation.json`, `attributions.npz`, and a picture of each of the first episodes."""
    import io

    from racines_data.files import write_atomic, write_json

    frames, buffer = explanation.frames, io.BytesIO()
    arrays = explanation.maps | {
        "images": frames.images,
        "episode": frames.row,
        "step": frames.step,
        "action": frames.actions,
    }
    whole: Any = {name: values.cpu().numpy() for name, values in arrays.items()}
    np.savez_compressed(buffer, **whole)
    write_atomic(folder / "attributions.npz", buffer.getvalue())
    for row in frames.row.unique().tolist()[:pictures]:
        draw_episode(explanation, row, folder / f"episode_{row:02d}.png")
    write_json(folder / "explanation.json", explanation.scores)
