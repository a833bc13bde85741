"""What a servo sees on its own ways, and how far it then is from the views.

After Ross, Gordon and Bagnell, A Reduction of Imitation Learning and Structured Prediction to
No-Regret Online Learning (2011): who has learned from the ways of others errs where only its own
errors lead, so it is let act on train patients, and learns on from what it sees there.
"""

from dataclasses import dataclass
from typing import Protocol

import torch

from racines_data.errors import RacinesError
from racines_data.patients.pool import Pool
from racines_data.randomness import derive
from racines_envs.agents.protocol import Agent
from racines_envs.agents.servo.frames import Frames, places_of, shrink, ways_to
from racines_envs.task.names import ANY_VIEW, BEATING, PATIENTS, task_name
from racines_envs.task.tiers import STEP_SECONDS
from racines_envs.worlds.making import make_core
from racines_envs.worlds.ward import Ward
from racines_models.networks.servo import ServoEnsemble, ServoNetwork

STREAM = 347


@dataclass(frozen=True)
class VisitConfig:
    """How a servo learns from its own ways."""

    rounds: int = 1
    """Times that it acts and learns on; 0: never."""
    patients: int = 60
    """Train patients on whom it acts in a round, each round others."""
    episodes: int = 32
    """Episodes on each, over all ways in which the patient lies."""
    steps: int = 60
    """Steps of an episode that are kept at most."""
    images: int = 300_000
    """Training images seen in a round."""
    share: float = 0.5
    """Of them, those of its own ways."""
    beside: int = 0
    """Train patients whose other frames are learned from beside; 0: all."""
    batch_size: int = 0
    """Of a round; 0: as of the first training."""
    learning_rate: float = 0.0
    """Peak of a round; 0: half the first training's."""

    def __post_init__(self) -> None:
        if self.rounds < 0 or min(self.patients, self.episodes, self.steps, self.images) < 1:
            raise RacinesError("agents.servo.visits: rounds are 0 or more, the rest 1 or more")
        if min(self.beside, self.batch_size, self.learning_rate) < 0:
            raise RacinesError(
                "agents.servo.visits: beside, batch_size and learning_rate are 0 or more"
            )
        if not 0.0 < self.share < 1.0:
            raise RacinesError(f"agents.servo.visits: share {self.share}: between 0 and 1")


class Reads(Agent, Protocol):
    """An agent that reads images by a network."""

    network: ServoNetwork | ServoEnsemble


@torch.no_grad()
def visit(agent: Reads, patient: int, places: int, config: VisitConfig, seed: int) -> Frames:
    """Let an agent act on a train patient, still or beating by the patient's seed.

    What it sees is a function of its weights, the patient, the settings and the seed.
    """
    ward = Ward(Pool(places_of(patient, places), beating=patient % 2 == 1))
    pool, count = ward.pool, config.episodes
    name = task_name(ANY_VIEW, tier=BEATING if pool.beating else PATIENTS)
    core = make_core(name, count, observation=agent.observation, reward="oracle", phantom=ward)
    agent.attach(core)
    seeds = derive(torch.full((count,), STREAM), seed, patient, torch.arange(count))
    observation = core.reset(seeds, case=torch.arange(count) % len(pool))
    seen: list[Frames] = []
    side = agent.network.side
    for _ in range(config.steps):
        state = core.state
        live = (~state.done).nonzero().squeeze(1)
        if len(live) == 0:
            break
        case, pose = state.case[live], state.taken(live).pose
        time = (state.began + STEP_SECONDS * state.steps)[live]
        phase = pool.phase(case, time) if pool.beating else None
        ways = ways_to(pose, pool.targets(case))
        grades = pool.judge(pose, case, phase).view_grade / 10.0
        shown = pool.scores(pose, case, phase).float()
        seen.append(Frames(shrink(observation["image"][live], side), ways, shown, grades))
        observation = core.step(
            agent.act(observation, core.decision_seeds()), rows=live
        ).observation
    return Frames(*(torch.cat(column) for column in zip(*seen, strict=True)))
