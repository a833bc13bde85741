"""Experience of a training gathered by groups of environments, here or on the workers of a cluster.

    a turn:  weights of the policy ──> group 0: rows 0 … n − 1     ──┐
                                   └─> group 1: rows n … 2 n − 1   ──┴─> one batch ──> an update

Each group acts with random numbers of its own, and its environments travel with the task: a worker
keeps nothing that counts, and one that dies costs its task only. All groups act by the same weights
and the update waits for all of them, so that every engine gives the same numbers.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import torch
from torch import Tensor

from racines_data.digest import recipe_digest
from racines_data.engines import Engine, open_engine
from racines_data.randomness import derive

if TYPE_CHECKING:
    from tensordict import TensorDictBase

HELD = ("state", "score", "_sensed", "_env_seed", "_episode")
"""Attributes of a core in which its rows' episodes are."""
_ACTS = 31
_made: dict[str, "Gathering"] = {}  # what this process gathers for, built once


class Gathering(Protocol):
    """A training that gathers so: a `TrainingRun`."""

    config: Any
    cls: Any
    seed: int
    frames: int
    identity: dict[str, Any]
    given: tuple[Any, Any, Any]
    env: Any
    policy: Any

    @property
    def starts(self) -> int:
        """The seed of the first environment's episodes, from here on."""
        ...

    def _build(self) -> None:
        """Make environments and policy."""
        ...


@dataclass(frozen=True)
class Site:
    """What the groups of one turn share."""

    name: str
    """Tells the trainings apart for which a process has gathered."""
    learner: Any
    """The class of the training."""
    agent: Any
    config: Any
    """Of one group."""
    seed: int
    given: tuple[Any, Any, Any]
    """Phantom, grader and data, as the training was given them."""
    weights: dict[str, Tensor]


class Turn(NamedTuple):
    """A group's part of one turn."""

    starts: int
    """The seed of its first row, where episodes begin."""
    acts: int
    """The seed of its actions."""
    held: "Held | None"
    """Where its episodes stand; None: they begin."""


class Held(NamedTuple):
    """The episodes of a group between two turns."""

    core: dict[str, Any]
    seen: "TensorDictBase"
    """What the policy sees next, (rows,)."""


def gathered(run: Gathering, engine: Engine | None) -> Iterator["TensorDictBase"]:
    """Yield batches (envs, steps) of a training's experience, without end.

    Args:
        run: A built run, whose `policy` acts with the weights that it has at each turn.
        engine: Where groups act; None: here, one after the other.
    """
    config = run.config
    count, rows = config.collectors, config.envs // config.collectors
    own = replace(config, envs=rows, update_every=config.update_every // count, collectors=1)
    name = recipe_digest({"of": run.identity, "rows": rows})
    starts = run.starts
    held: list[Held | None] = [None] * count
    here = engine or open_engine()
    while True:
        weights = {key: value.cpu() for key, value in run.policy.state_dict().items()}
        site = Site(name, type(run), run.cls, own, run.seed, run.given, weights)
        seed = torch.tensor(run.seed)
        turns = [
            Turn(starts + rows * k, int(derive(seed, _ACTS, run.frames, k)), held[k])
            for k in range(count)
        ]
        parts, held = [], []
        for part, after in here.map(gather, site, turns, config.threads or None):
            parts.append(part)
            held.append(after)
        batch: Any = torch.cat(parts, 0)
        yield batch.to(config.device)


def gather(site: Site, turn: Turn) -> tuple["TensorDictBase", Held]:
    """Return a group's (rows, steps) of experience, and where its episodes stand after it."""
    from torchrl.envs.utils import ExplorationType, set_exploration_type

    config = site.config
    with torch.random.fork_rng(), torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        run = _learner(site)
        env: Any = run.env
        run.policy.load_state_dict(site.weights)
        torch.manual_seed(turn.acts)
        if turn.held is None:
            env.set_seed(turn.starts)
            seen = env.reset()
        else:
            for name, value in turn.held.core.items():
                setattr(env.core, name, value)
            seen = turn.held.seen
        steps: list[Any] = []
        for _ in range(config.update_every // config.envs):
            stepped, seen = env.step_and_maybe_reset(run.policy(seen))
            steps.append(stepped)
        core = {name: getattr(env.core, name) for name in HELD}
    batch: Any = torch.stack(steps, 1)
    return batch, Held(core, seen)


def _learner(site: Site) -> Gathering:
    """Return the training as it is built in this process, with environments for one group."""
    if site.name not in _made:
        phantom, grader, data = site.given
        run = site.learner(site.agent, site.config, Path(), site.seed, phantom, grader, False, data)
        run._build()
        _made.clear()
        _made[site.name] = run
    return _made[site.name]
