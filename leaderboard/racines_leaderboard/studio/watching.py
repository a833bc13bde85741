"""Watching an agent: which there are, an episode of one, and what moved it at a step.

An episode follows from the agent's files, the task and the start, so all who ask for the same one
are shown the same one; the last few are kept. What was not offered raises a `RacinesError`, and so
does an agent whose files are damaged.
"""

import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from racines_data.errors import RacinesError
from racines_envs.agents import agent_class, agent_names, load_agent
from racines_envs.agents.protocol import encoder_of
from racines_envs.apis.rendering import History, Steps
from racines_envs.explain import maps
from racines_envs.robots.arm import FREE
from racines_envs.task.names import ANY_VIEW, TIERS, tier_of
from racines_leaderboard.studio import inputs, worlds
from racines_leaderboard.studio.driving import robots
from racines_leaderboard.studio.parts import Place, Shared, trained_runs
from racines_leaderboard.studio.scene import Curve, Scene, Snapshot, judged, snapshot, take_scene
from racines_leaderboard.studio.worlds import FIRST_PATIENT, FIXED, Start

UNTRAINED = ("planner", "random", "hill-climber")
"""Agents that need no files of their own."""
POLICY = "policy.safetensors"
OFF, ACTION, TARGET = "off", "chosen action", "target view, by the grader"
READ = "target view, as the agent reads it"
EXPLAINED = (OFF, ACTION, READ, TARGET)
"""What may be attributed to the pixels."""
POINTS = 24
"""Of the integral: fewer than `racines explain` takes, so that a step is there in a second."""
_episodes: Shared["Episode"] = Shared(24)
_maps: Shared[tuple[np.ndarray, float]] = Shared(256)
_explaining = threading.Lock()
"""One integral at a time: it is the most that a visitor can ask for."""


@dataclass(frozen=True)
class Watchable:
    """An agent that can be watched."""

    label: str
    """What the page calls it."""
    agent: str
    """Registered name."""
    folder: Path
    task: str | None
    """The task it was trained for; None for any view."""
    tiers: tuple[str, ...]
    """Where it acts: on the one heart, on still or on beating patients."""
    changed: int
    """When its files last changed, ns."""


@dataclass(frozen=True, eq=False)
class Episode:
    """An episode from start to end; T steps."""

    key: tuple[Any, ...]
    agent: Any
    core: Any
    """Never moved again."""
    grader: Any
    moments: tuple[Snapshot, ...]
    """T + 1."""
    params: Any
    """(T + 1, 9), the probe's pose as an agent is shown it."""
    history: Any
    """The episode's `Steps`."""
    curves: tuple[Curve, ...]
    """By the grader, where there is one, and by the truth."""

    @property
    def steps(self) -> int:
        """Steps that were taken."""
        return len(self.moments) - 1

    @property
    def explainable(self) -> tuple[str, ...]:
        """What can be attributed to pixels here."""
        looks = hasattr(self.agent, "logits") and self.agent.observation != "params"
        own = getattr(self.agent, "encoder", None) is not encoder_of(self.agent)
        looks = looks and not own  # whose own eyes add up what was seen: no gradient leads there
        reads = hasattr(self.agent, "view_scores")
        offered = {OFF: True, ACTION: looks, READ: reads}
        offered |= {TARGET: hasattr(self.grader, "network")}
        return tuple(name for name, there in offered.items() if there)


def agents(place: Place) -> dict[str, Watchable]:
    """Return the agents by label: those without files, the published policies, then the runs."""
    offered = {
        name: Watchable(name, name, place.agents / name, *_where(name, {}), 0) for name in UNTRAINED
    }
    folders = (place.policies, " (published)"), (place.agents, "")
    for label, config, weights in trained_runs(POLICY, *folders):
        # Only registered names: `module:Class` would let a folder choose what is imported.
        if label not in offered and (agent := config.get("agent")) in agent_names():
            settings, changed = config.get("config"), weights.stat().st_mtime_ns
            settings = settings if isinstance(settings, dict) else {}
            try:
                found = Watchable(label, agent, weights.parent, *_where(agent, settings), changed)
            except RacinesError:
                continue  # of a package that is installed and cannot be imported
            if _tasks(found):
                offered[label] = found
    return offered


def _where(agent: str, settings: dict[str, Any]) -> tuple[str | None, tuple[str, ...]]:
    """Return the task that an agent of some settings was trained for, and where it acts."""
    kind = agent_class(agent)
    if tiers := getattr(kind, "tiers", ()):
        return None, tiers
    task = str(settings.get("view") or "")
    if task.startswith(ANY_VIEW) and hasattr(kind, "any_view"):
        return None, TIERS[1:]
    return task or None, (tier_of(task),)


def _tasks(agent: Watchable) -> list[str]:
    return [name for name in worlds.tasks()
            if tier_of(name) in agent.tiers and agent.task in (None, name)]  # fmt: skip


def _offered(place: Place, label: Any) -> Watchable:
    offered = agents(place)
    return offered[inputs.choice(label, tuple(offered), "agent")]


def tasks_of(place: Place, label: Any) -> list[str]:
    """Return the tasks that an agent can be watched in."""
    return _tasks(_offered(place, label))


def watch(
    place: Place, label: Any, task: Any, number: Any, robot: Any = FREE,
    patient: Any = FIRST_PATIENT,
) -> Episode:  # fmt: skip
    """Return the episode of an agent from a fixed start, run now or before."""
    chosen = _offered(place, label)
    inputs.choice(task, tasks_of(place, label), "task")
    start = worlds.start_of(task, FIXED, number, robot, patient, robots())
    key = chosen, start, place.device
    return _episodes.get(key, lambda: _run(place, chosen, start, key))


def moment(episode: Episode, step: Any) -> Scene:
    """Return what the page shows of a step."""
    step = inputs.whole(step, 0, episode.steps, "step")
    past = Steps(*(entries[: step + 1] for entries in vars(episode.history).values()))
    return take_scene(episode.core, episode.moments[step], past, episode.curves, True)


def explain(episode: Episode, step: Any, what: Any) -> tuple[np.ndarray, float]:
    """Return the (128, 128) attributions of a step's image, and the probability explained."""
    step = inputs.whole(step, 0, episode.steps, "step")
    what = inputs.choice(what, episode.explainable, "attributions")
    if what == ACTION and step == episode.steps:
        raise RacinesError("the last image led to no action: choose an earlier step")
    return _maps.get((episode.key, step, what), lambda: _explain(episode, step, what))


def _explain(episode: Episode, step: int, what: str) -> tuple[np.ndarray, float]:
    with _explaining:
        if what == ACTION:
            judge, target = maps.policy_logits(episode.agent), episode.history.actions[step + 1]
        else:
            target = episode.core.task.target
            by_grader = what == TARGET
            judge = (
                maps.grader_probabilities(episode.grader) if by_grader
                else maps.view_scores(episode.agent)
            )  # fmt: skip
        image, params = episode.moments[step].image, episode.params[step : step + 1]
        targets = torch.tensor([target], device=image.device)
        attributions, _ = maps.integrated_gradients(judge, image, params, targets, POINTS)
        output = maps.outputs(judge, image, params)[0]
    p = output.softmax(-1) if what == ACTION else output
    return attributions[0].cpu().numpy(), float(p[target])


def _run(place: Place, chosen: Watchable, start: Start, key: tuple[Any, ...]) -> Episode:
    """Let the agent act until its episode ends, 200 steps at most."""
    agent: Any = load_agent(chosen.agent, chosen.folder, place.device)
    core, grader = worlds.core_and_grader(place, start, "multimodal", encoder_of(agent))
    if hasattr(agent, "guide"):
        if grader is None:
            raise RacinesError(f"{chosen.label}: goes by a grader, and none of these views is here")
        agent.guide = grader
    agent.attach(core)
    # An agent is shown what it asks to see, of all that there is.
    hidden = {"image": ("params",), "params": ("image", "features")}.get(agent.observation, ())
    history, moments, params = History(1), [], []
    seen, action = worlds.reset(core, start), None
    while True:
        history.note(core, action)
        moments.append(snapshot(core))
        params.append(seen["params"])
        if bool(core.state.done[0]):
            break
        shown = {name: value for name, value in seen.items() if name not in hidden}
        action = agent.act(shown, core.decision_seeds())
        seen = core.step(action).observation
    steps = history[0]
    curves: tuple[Curve, ...] = (Curve("truth", steps.probabilities, steps.grades),)
    if grader is not None:
        images = [moment.image for moment in moments]
        curves = Curve("grader", *judged(grader, images, core.task.target)), *curves
    return Episode(key, agent, core, grader, tuple(moments), torch.cat(params), steps, curves)


ENLARGED = 3
"""Times the image's size: attributions are smooth, the image keeps its pixels."""
SOFT = 1.2
"""Blur of the drawn attributions, pixels."""
FOR, AGAINST = np.array([255.0, 70.0, 50.0]), np.array([70.0, 150.0, 255.0])


def overlay(image: np.ndarray, attributions: np.ndarray) -> np.ndarray:
    """Return a (128, 128) uint8 image with its attributions as (384, 384, 3) uint8.

    Red speaks for what is explained, blue against; the strongest hundredth is opaque.
    """
    soft = maps.blur(torch.from_numpy(attributions).float().unsqueeze(0), SOFT)[0].numpy()
    scale = max(float(np.quantile(np.abs(soft), 0.99)), 1e-12)
    share = _enlarge(soft / scale).clip(-1.0, 1.0)
    gray = _enlarge(image).clip(0.0, 255.0)
    strength = np.abs(share) ** 0.8
    colour = np.where(share > 0, FOR, AGAINST)
    return (0.8 * gray * (1.0 - strength) + colour * strength).round().astype(np.uint8)


def _enlarge(values: np.ndarray) -> np.ndarray:
    """Return (128, 128) numbers enlarged, interpolated, with an axis for colours."""
    size = values.shape[1] * ENLARGED, values.shape[0] * ENLARGED
    picture = Image.fromarray(values.astype(np.float32))
    return np.asarray(picture.resize(size, Image.Resampling.BILINEAR))[..., None]
