"""Watching an agent: which there are, an episode of one, and what moved it at a step.

An episode follows from the agent's files, the task and the start, so all who ask for the same one
are shown the same one; the last few are kept.
"""

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from racines_data.errors import RacinesError
from racines_leaderboard.studio import inputs
from racines_leaderboard.studio.driving import FIXED, FIXED_STARTS, reset_seed
from racines_leaderboard.studio.parts import load_grader, load_phantom, read_config
from racines_leaderboard.studio.place import Place
from racines_leaderboard.studio.scene import Curve, Scene, Snapshot, snapshot, take_scene
from racines_leaderboard.studio.shared import Shared

UNTRAINED = ("planner", "random", "hill-climber")
"""Agents that need no files of their own."""
POLICY = "policy.safetensors"
OFF, ACTION, TARGET = "off", "chosen action", "target view, by the grader"
EXPLAINED = (OFF, ACTION, TARGET)
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
    view: str | None
    """The task it was trained for; None for any."""
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
    judged: Curve | None
    """By the grader, where there is one."""

    @property
    def steps(self) -> int:
        """Steps that were taken."""
        return len(self.moments) - 1

    @property
    def explainable(self) -> tuple[str, ...]:
        """What can be attributed to pixels here."""
        looks = hasattr(self.agent, "logits") and self.agent.observation != "params"
        offered = [OFF]
        return tuple(offered + [ACTION] * looks + [TARGET] * hasattr(self.grader, "network"))


def agents(place: Place) -> dict[str, Watchable]:
    """Return the agents by label: those without files, the published policies, then the runs."""
    offered = {name: Watchable(name, name, place.agents / name, None, 0) for name in UNTRAINED}
    for parent, suffix in ((place.policies, " (published)"), (place.agents, "")):
        for config in sorted(parent.glob("*/config.json")):
            label = f"{config.parent.name}{suffix}"
            run = _watchable(label, config)
            if run is not None and label not in offered:
                offered[label] = run
    return offered


def _watchable(label: str, config: Path) -> Watchable | None:
    """Return the agent of a run folder; None where it holds none that is registered here."""
    from racines_envs.agents import agent_names

    content, weights = read_config(config), config.parent / POLICY
    # Only registered names: `module:Class` would let a folder choose what is imported.
    if content.get("agent") not in agent_names() or not weights.is_file():
        return None
    settings = content.get("config")
    view = settings.get("view") if isinstance(settings, dict) else None
    return Watchable(label, content["agent"], config.parent, view, weights.stat().st_mtime_ns)


def tasks_of(place: Place, label: Any) -> list[str]:
    """Return the tasks that an agent can be watched in.

    Raises:
        RacinesError: an agent that is not offered.
    """
    from racines_envs.task.tasks import TASKS

    offered = agents(place)
    view = offered[inputs.choice(label, tuple(offered), "agent")].view
    return [name for name, task in TASKS.items() if view in (None, task.view)]


def watch(place: Place, label: Any, task: Any, number: Any) -> Episode:
    """Return the episode of an agent from a fixed start, run now or before.

    Raises:
        RacinesError: what is not offered, or an agent whose files are damaged.
    """
    offered = agents(place)
    chosen = offered[inputs.choice(label, tuple(offered), "agent")]
    task = inputs.choice(task, tasks_of(place, label), "task")
    number = inputs.whole(number, 0, FIXED_STARTS - 1, "number of the start")
    key = chosen, task, number, place.device
    return _episodes.get(key, lambda: _run(place, chosen, key))


def moment(episode: Episode, step: Any) -> Scene:
    """Return what the page shows of a step.

    Raises:
        RacinesError: a step that the episode does not have.
    """
    from racines_envs.apis.rendering import Steps

    step = inputs.whole(step, 0, episode.steps, "step")
    history = episode.history
    past = Steps(*(entries[: step + 1] for entries in vars(history).values()))
    curves = [Curve("truth", tuple(history.probabilities), tuple(history.grades))]
    if episode.judged is not None:
        curves.insert(0, episode.judged)
    return take_scene(episode.core, episode.moments[step], past, curves, True)


def explain(episode: Episode, step: Any, what: Any) -> tuple[np.ndarray, float]:
    """Return the (128, 128) attributions of a step's image, and the probability explained.

    Raises:
        RacinesError: a step that took no action, or what cannot be explained here.
    """
    step = inputs.whole(step, 0, episode.steps, "step")
    what = inputs.choice(what, episode.explainable, "attributions")
    if what == ACTION and step == episode.steps:
        raise RacinesError("the last image led to no action: choose an earlier step")
    return _maps.get((episode.key, step, what), lambda: _explain(episode, step, what))


def _explain(episode: Episode, step: int, what: str) -> tuple[np.ndarray, float]:
    import torch

    from racines_envs.explain.maps import (
        grader_probabilities,
        integrated_gradients,
        outputs,
        policy_logits,
    )

    with _explaining:
        if what == ACTION:
            judge, target = policy_logits(episode.agent), episode.history.actions[step + 1]
        else:
            judge, target = grader_probabilities(episode.grader), episode.core.task.target
        image, params = episode.moments[step].image, episode.params[step : step + 1]
        targets = torch.tensor([target], device=image.device)
        maps, _ = integrated_gradients(judge, image, params, targets, POINTS)
        output = outputs(judge, image, params)[0]
    p = output.softmax(-1) if what == ACTION else output
    return maps[0].cpu().numpy(), float(p[target])


def _run(place: Place, chosen: Watchable, key: tuple[Any, ...]) -> Episode:
    """Let the agent act until its episode ends, 200 steps at most."""
    import torch

    from racines_envs.agents import load_agent
    from racines_envs.apis.rendering import History, view_names
    from racines_envs.task.tasks import TASKS
    from racines_envs.worlds.making import make_core

    agent: Any = load_agent(chosen.agent, chosen.folder, place.device)
    task = TASKS[key[1]]
    core = make_core(
        task,
        observation="multimodal",
        reward="oracle",
        phantom=load_phantom(place, task.anatomy),
        device=place.device,
        encoder=getattr(agent, "encoder", None),
    )
    grader = load_grader(place, view_names(core))
    if hasattr(agent, "guide"):
        if grader is None:
            raise RacinesError(f"{chosen.label}: goes by a grader, and none of these views is here")
        agent.guide = grader
    history, moments, params = History(1), [], []
    agent.attach(core)
    seen, action = core.reset(reset_seed(FIXED, key[2])), None
    while True:
        history.note(core, action)
        moments.append(snapshot(core))
        params.append(seen["params"])
        if bool(core.state.done[0]):
            break
        action = agent.act(_asked_for(seen, agent.observation), core.decision_seeds())
        seen = core.step(action).observation
    judged = _judged(grader, [moment.image for moment in moments], task.target)
    return Episode(
        key, agent, core, grader, tuple(moments), torch.cat(params), history[0], judged
    )  # fmt: skip


def _asked_for(seen: dict[str, Any], observation: str) -> dict[str, Any]:
    """Return what an agent asks to see, of all that there is."""
    hidden = {"image": ("params",), "params": ("image", "features")}.get(observation, ())
    return {name: value for name, value in seen.items() if name not in hidden}


def _judged(grader: Any, images: Sequence[Any], target: int) -> Curve | None:
    import torch

    if grader is None:
        return None
    p, grades = grader.probabilities_and_grade(torch.cat(list(images)))
    return Curve("grader", tuple(p[:, target].tolist()), tuple(grades.tolist()))


ENLARGED = 3
"""Times the image's size: attributions are smooth, the image keeps its pixels."""
SOFT = 1.2
"""Blur of the drawn attributions, pixels."""
FOR, AGAINST = np.array([255.0, 70.0, 50.0]), np.array([70.0, 150.0, 255.0])


def overlay(image: np.ndarray, attributions: np.ndarray) -> np.ndarray:
    """Return an image with its attributions: red speaks for what is explained, blue against.

    Args:
        image: (128, 128) uint8.
        attributions: (128, 128); the strongest hundredth is opaque.

    Returns:
        (384, 384, 3) uint8.
    """
    import torch

    from racines_envs.explain.scores import blur

    soft = blur(torch.from_numpy(attributions).float().unsqueeze(0), SOFT)[0].numpy()
    scale = max(float(np.quantile(np.abs(soft), 0.99)), 1e-12)
    share = _enlarge(soft / scale).clip(-1.0, 1.0)[..., None]
    gray = _enlarge(image.astype(np.float32))[..., None].clip(0.0, 255.0)
    strength = np.abs(share) ** 0.8
    colour = np.where(share > 0, FOR, AGAINST)
    return (0.8 * gray * (1.0 - strength) + colour * strength).round().astype(np.uint8)


def _enlarge(values: np.ndarray) -> np.ndarray:
    """Return (128, 128) numbers enlarged, interpolated."""
    size = values.shape[1] * ENLARGED, values.shape[0] * ENLARGED
    picture = Image.fromarray(values.astype(np.float32))
    return np.asarray(picture.resize(size, Image.Resampling.BILINEAR))
