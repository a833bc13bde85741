"""Why an agent moved as it did: attributions along episodes, scored, and beside the truth."""

import io
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.files import write_atomic, write_json
from racines_data.geometry import Pose
from racines_envs.agents import agent_class, load_agent
from racines_envs.evaluation.run import check_view
from racines_envs.explain import maps as attribution
from racines_envs.task.actions import ACTIONS
from racines_envs.task.core import ScanCore
from racines_envs.task.names import HEART_TIER
from racines_envs.task.rewards import get_reward
from racines_envs.task.starts import evaluation_seeds
from racines_envs.worlds.backends import make_grader
from racines_envs.worlds.making import WorldLike, find_task, make_core, phantom_recipe
from racines_models.devices import on_device
from racines_models.protocol import Judge
from racines_models.provenance import code_version, environment, weights_sha256
from racines_models.statistics import evidence

SCHEMA = "racines.explanation/1"
COLUMNS = 6
"""Images in a figure at most; evenly taken from the episode's."""
TITLES = {"policy": "chosen action", "grader": "target view,\nby the grader"}
_SOFT = 1.2
"""Blur of the drawn attributions, pixels; the scores are taken without."""


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
    device: str = "cpu"


@dataclass(frozen=True)
class Shown:
    """The images of an agent's episodes that are explained, n in all."""

    images: Tensor
    """(n, 128, 128) uint8."""
    params: Tensor
    """(n, 9); zeros where the agent does not look at them."""
    pose: Pose
    actions: Tensor
    """(n,) int64, what the agent did there."""
    row: Tensor
    """(n,) int64, the episode."""
    step: Tensor
    """(n,) int64, steps before it."""


@dataclass(frozen=True)
class Explanation:
    """Attributions and their scores."""

    scores: dict[str, Any]
    frames: Shown
    maps: dict[str, Tensor]
    """(n, 128, 128) attributions of the chosen action (`policy`) and the target view (`grader`)."""
    regions: dict[str, Tensor]
    """(n, 128, 128) bool, inside the sector; see `true_regions`."""
    probabilities: dict[str, Tensor]
    """(n,) probability of what is attributed."""


def explain(
    name: str, run_dir: Path, config: ExplainConfig, phantom: WorldLike = None,
    grader: Judge | None = None,
) -> Explanation:  # fmt: skip
    """Explain the agent that lies in `run_dir`; arguments as of `evaluate`.

    Raises:
        RacinesError: an agent that looks at no image, or has no gradients, or was trained for
            another view; unknown names; missing weights.
    """
    for field in ("starts", "every", "steps", "random_maps"):
        if getattr(config, field) < 1:
            raise RacinesError(f"explain.{field} is {getattr(config, field)}: give at least 1")
    config = on_device(config)
    task = find_task(config.view, phantom)
    agent = load_agent(name, run_dir, config.device)
    judge = attribution.policy_logits(agent)
    check_view(agent, config.view, name, run_dir)
    if task.tier != HEART_TIER:
        raise RacinesError(
            f"explain.view: {config.view} is a task on patients, and regions of truth are known of "
            "one heart: `racines studio` draws what moved an agent there, a step at a time"
        )
    if grader is None and config.grader:
        grader = make_grader(config.grader, config.device)
    core = make_core(
        config.view, config.starts, backend=config.backend, generator=config.generator or None,
        observation=agent.observation, reward=config.reward, phantom=phantom,
        data=config.data or None, device=config.device,
        grader=grader if get_reward(config.reward).needs_judge else None,
    )  # fmt: skip
    frames = collect(core, agent, evaluation_seeds(config.starts, config.seed), config)
    sector, regions = attribution.sector_of(core.phantom), {}
    # A recorded frame is of another pose, near by: what lies under its pixels is not known.
    if config.backend != "replay":
        truth = attribution.true_regions(core.phantom, frames.pose, config.view)
        regions = {region: inside & sector for region, inside in truth.items()}
    questions = {"policy": _Question(config, frames, sector, judge, frames.actions, True)}
    if grader is not None:
        target = torch.full_like(frames.actions, task.target)
        judge = attribution.grader_probabilities(grader)
        questions["grader"] = _Question(config, frames, sector, judge, target, False)
    maps, probabilities, metrics = {}, {}, {}
    for what, question in questions.items():
        maps[what], probabilities[what], error = question.attribute()
        metrics[what] = question.score(maps[what]) | error | question.overlaps(maps[what], regions)
    scores = {
        "schema": SCHEMA,
        "agent": agent_class(name).name,
        "settings": asdict(config),
        "method": "Integrated Gradients, Gauss-Legendre, black baseline",
        "phantom": phantom_recipe(core.phantom),
        "images": len(frames.images),
        "metrics": metrics,
        "weights": weights_sha256(Path(run_dir)) if Path(run_dir).is_dir() else {},
        "code": code_version(),
        "environment": environment(str(core.device)),
    }
    return Explanation(scores, frames, maps, regions, probabilities)


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
            kept.append((*(x[live] for x in seen), *rows))
        observation = core.step(action).observation
    images, params, position, rotation, actions, row, step = (
        torch.cat(column) for column in zip(*kept, strict=True)
    )
    return Shown(images, params, Pose(position, rotation), actions, row, step)


@dataclass(frozen=True)
class _Question:
    """What is attributed: an output of the policy, or of the grader, at each of n images."""

    config: ExplainConfig
    frames: Shown
    sector: Tensor  # (128, 128) bool
    judge: attribution.Explained
    targets: Tensor  # (n,) int64, which output
    logits: bool  # whether outputs are logits, to be turned into probabilities

    def attribute(self) -> tuple[Tensor, Tensor, dict[str, Any]]:
        """Return attributions, the probability of each target, and the completeness error."""
        images, params, judge = self.frames.images, self.frames.params, self.judge
        maps, error = attribution.integrated_gradients(
            judge, images, params, self.targets, self.config.steps
        )
        full = attribution.outputs(judge, images, params)
        black = attribution.outputs(judge, torch.zeros_like(images), params)
        change = self._wanted(full - black).abs()
        relative = (error.abs() / change.clamp_min(1e-6)).cpu().numpy()
        unit = "|sum of the attributions - change of the output| / change"
        figure = evidence.figure("median", relative, unit, 0.0, units=self._rows())
        probability = self._wanted(full.softmax(-1) if self.logits else full)
        return maps, probability, {"completeness_error": figure}

    def _wanted(self, found: Tensor) -> Tensor:
        return found.gather(1, self.targets.unsqueeze(1)).squeeze(1)

    def score(self, maps: Tensor) -> dict[str, Any]:
        """Return deletion and insertion of the maps, of random ones, and the differences."""
        figures: dict[str, Any] = {}
        for name, insert in (("deletion", False), ("insertion", True)):
            own = self._area(maps, insert)
            figures[name] = self._mean(own)
            for kind, sigma in (("random", 0.0), ("smooth_random", attribution.SMOOTH)):
                seeds = range(self.config.random_maps)
                drawn = (attribution.random_maps(maps.shape, seed, sigma) for seed in seeds)
                noise = np.mean([self._area(each.to(maps.device), insert) for each in drawn], 0)
                figures[f"{name}_{kind}"] = self._mean(noise)
                better = (noise - own) * (-1 if insert else 1)
                figures[f"{name}_gain_over_{kind}"] = self._mean(better)
        return figures

    def overlaps(self, maps: Tensor, regions: dict[str, Tensor]) -> dict[str, Any]:
        """Return where the top tenth of the pixels by magnitude lies, and by chance would."""
        figures: dict[str, Any] = {}
        for name, region in regions.items():
            hit, chance = attribution.overlap(maps.abs().cpu(), region, self.sector)
            figures[f"overlap_{name}"] = self._mean(hit)
            figures[f"overlap_{name}_by_chance"] = self._mean(chance)
            figures[f"overlap_{name}_gain"] = self._mean(hit - chance)
        return figures

    def _area(self, maps: Tensor, insert: bool) -> np.ndarray:
        shown, sector = self.frames, self.sector.to(maps.device)
        return attribution.areas(
            self.judge, shown.images, shown.params, self.targets, maps, sector, insert, self.logits
        )

    def _mean(self, values: np.ndarray) -> dict[str, Any]:
        """Return the mean over episodes of their mean images: images of one episode are alike."""
        row = self._rows()
        episodes = np.array([values[row == r].mean() for r in np.unique(row)])
        return evidence.figure("mean", episodes) | {"images": len(values)}

    def _rows(self) -> np.ndarray:
        """Return the (n,) episodes of the images."""
        return self.frames.row.cpu().numpy()


def write_explanation(explanation: Explanation, folder: Path, pictures: int = 4) -> None:
    """Write `explanation.json`, `attributions.npz`, and a picture of each of the first episodes."""
    frames, buffer = explanation.frames, io.BytesIO()
    arrays = explanation.maps | {"images": frames.images, "episode": frames.row}
    arrays |= {"step": frames.step, "action": frames.actions}
    whole: Any = {name: values.cpu().numpy() for name, values in arrays.items()}
    np.savez_compressed(buffer, **whole)
    write_atomic(folder / "attributions.npz", buffer.getvalue())
    for row in frames.row.unique().tolist()[:pictures]:
        draw_episode(explanation, row, folder / f"episode_{row:02d}.png")
    write_json(folder / "explanation.json", explanation.scores)


def draw_episode(explanation: Explanation, row: int, path: Path) -> None:
    """Draw the images of an episode over their attributions, as PNG.

    Red speaks for the chosen action (or the target view), blue against; yellow lines are true
    borders of tissues.
    """
    from racines_data.plotting import card_style, encode

    with card_style():
        write_atomic(path, encode(_episode_figure(explanation, row), few=False, dpi=140))


def _episode_figure(explanation: Explanation, row: int) -> Any:
    """Return the figure of an episode: images above, attributions below."""
    from matplotlib.figure import Figure

    from racines_data.plotting import YELLOW

    frames, kinds = explanation.frames, list(explanation.maps)
    chosen = (frames.row == row).nonzero().squeeze(1)
    if len(chosen) > COLUMNS:
        chosen = chosen[torch.linspace(0, len(chosen) - 1, COLUMNS).round().long()]
    lines = 1 + len(kinds)
    size = (1.9 * len(chosen) + 0.6, 2.15 * lines + 0.35)
    figure = Figure(figsize=size, layout="constrained")
    axes: Any = figure.subplots(lines, len(chosen), squeeze=False)
    for index, column in zip(chosen.tolist(), axes.T, strict=True):
        action = ACTIONS[int(frames.actions[index])]
        image = frames.images[index].cpu().numpy()
        column[0].set_title(f"step {int(frames.step[index])}: {action}", fontsize=9)
        column[0].imshow(image, cmap="gray", vmin=0, vmax=255)
        for kind, axis in zip(kinds, column[1:], strict=True):
            _overlay(axis, image, explanation.maps[kind][index])
            if "borders" in explanation.regions:
                borders = explanation.regions["borders"][index].cpu().numpy()
                axis.contour(borders, [0.5], colors=YELLOW, linewidths=0.25)
            found = float(explanation.probabilities[kind][index])
            axis.set_title(f"p {found:.2f}", fontsize=8, pad=2)
    for axis, label in zip(axes[:, 0], ["image", *(TITLES[kind] for kind in kinds)], strict=True):
        axis.set_ylabel(label, fontsize=9)
    for axis in axes.flat:
        axis.set(xticks=[], yticks=[])
    view = explanation.scores["settings"]["view"]
    figure.suptitle(f"{explanation.scores['agent']} on {view}, start {row}", fontsize=10)
    return figure


def _overlay(axis: Any, image: np.ndarray, drawn: Tensor) -> None:
    """Lay a softened attribution over an image; the strongest hundredth is opaque."""
    from racines_data.plotting import SIGNED

    soft = attribution.blur(drawn.unsqueeze(0).cpu(), _SOFT)[0].numpy()
    scale = max(float(np.quantile(np.abs(soft), 0.99)), 1e-12)
    strength = np.clip(np.abs(soft) / scale, 0.0, 1.0)
    axis.imshow(image * 0.7, cmap="gray", vmin=0, vmax=255)
    axis.imshow(soft, cmap=SIGNED, vmin=-scale, vmax=scale, alpha=strength**0.8)
