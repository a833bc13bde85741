"""What a memory learns from: whole episodes of its agent on train patients, and their truth.

After Ross, Gordon and Bagnell, A Reduction of Imitation Learning and Structured Prediction to
No-Regret Online Learning (2011): first of a servo that only searches, then of the agent itself.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

import torch
from safetensors.torch import save_file
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.files import read_tensors, write_once
from racines_data.patients.pool import Pool
from racines_data.randomness import derive
from racines_envs.agents.memory.notes import LONGEST, Notes, lies
from racines_envs.agents.protocol import Agent
from racines_envs.agents.servo.frames import places_of
from racines_envs.task.names import ANY_VIEW, BEATING, PATIENTS, task_name
from racines_envs.worlds.making import make_core
from racines_envs.worlds.ward import Ward

STREAM = 359


@dataclass(frozen=True)
class EpisodeConfig:
    """On whom it acts."""

    episodes: int = 10
    """Episodes on each patient, over all ways in which the patient lies."""
    places: int = 5
    """Ways in which a patient lies: as frames of a servo have them."""

    def __post_init__(self) -> None:
        if min(self.episodes, self.places) < 1:
            raise RacinesError("agents.servo-memory.acts: episodes and places are 1 or more")


class Noting(Agent, Protocol):
    """An agent that notes what it sees."""

    notes: Notes


class Episodes(NamedTuple):
    """N episodes."""

    tokens: Tensor
    """(N, T, TOKEN), see `RecallNetwork`."""
    seen: Tensor
    """(N, T) bool, which there are."""
    truths: Tensor
    """(N, T, 2) p and a tenth of the grade at each pose, over a beat where the heart beats."""
    labels: Tensor
    """(N,) int64."""
    target: Tensor
    """(N, 6) where the patient's nominal pose lies."""

    @property
    def hits(self) -> Tensor:
        """(N, T) bool: poses at which a declaration would have been right."""
        return (self.truths[..., 0] >= HIT[0]) & (self.truths[..., 1] >= HIT[1]) & self.seen


HIT = 0.9, 0.5
"""Completeness, and tenth of the grade, of a hit, less what half precision rounds."""


@torch.no_grad()
def act_on(agent: Noting, patient: int, config: EpisodeConfig, seed: int) -> Episodes:
    """Let an agent act on a patient, still or beating by the patient's seed."""
    ward = Ward(Pool(places_of(patient, config.places), beating=patient % 2 == 1))
    pool, count = ward.pool, config.episodes
    name = task_name(ANY_VIEW, tier=BEATING if pool.beating else PATIENTS)
    core = make_core(name, count, observation=agent.observation, reward="oracle", phantom=ward)
    agent.attach(core)
    seeds = derive(torch.full((count,), STREAM), seed, patient, torch.arange(count))
    observation = core.reset(seeds, case=torch.arange(count) % len(pool))
    truths, seen = torch.zeros(count, LONGEST, 2), torch.zeros(count, LONGEST, dtype=torch.bool)
    for step in range(min(core.task.max_steps, LONGEST)):
        live = ~core.state.done
        if not bool(live.any()):
            break
        told = core.scored_by("oracle")
        truths[:, step] = torch.stack([told.probability, told.grade / 10.0], -1)
        seen[:, step] = live
        action = agent.act(observation, core.decision_seeds())
        observation = core.step(action, rows=live.nonzero().squeeze(1)).observation
    labels = core.state.goal
    target = lies(core.target, labels)
    length = int(seen.any(0).sum())
    seen, truths = seen[:, :length], truths[:, :length]
    tokens = torch.where(seen.unsqueeze(-1), agent.notes.tokens[:, :length].cpu(), 0.0)
    return Episodes(tokens, seen, truths, labels, target)


def kept(path: Path, make: Callable[[], Episodes]) -> Episodes:
    """Return the episodes of a file, or make them and put them there; all of the longest length.

    Raises:
        RacinesError: a damaged file.
    """
    if not path.is_file():
        made = make()
        columns = made._asdict() | {"tokens": made.tokens.half(), "truths": made.truths.half()}
        columns = {name: column.contiguous() for name, column in columns.items()}
        path.parent.mkdir(parents=True, exist_ok=True)
        write_once(path, lambda part: save_file(columns, part))
    found = Episodes(**read_tensors(path, Episodes._fields))
    short = LONGEST - found.tokens.shape[1]
    longer = [torch.nn.functional.pad(x, (0, 0, 0, short)) for x in (found.tokens, found.truths)]
    seen = torch.nn.functional.pad(found.seen, (0, short))
    return Episodes(longer[0], seen, longer[1], found.labels, found.target)


def joined(parts: list[Episodes]) -> Episodes:
    """Return all episodes."""
    return Episodes(*(torch.cat(column) for column in zip(*parts, strict=True)))
