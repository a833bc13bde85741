"""A memory's trainings: the first from a servo's episodes, each that follows from its own as well.

The servo acts on train patients, and the memory learns from its episodes; the agent with the memory
acts on others, and the memory learns on from all episodes; and so on.
"""

import json
import shutil
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from racines_data.digest import recipe_digest
from racines_data.files import write_json
from racines_data.patients.patient import PATIENTS_VERSION
from racines_data.patients.splits import seeds_of
from racines_envs.agents.many import exhaust, of_each
from racines_envs.agents.memory.episodes import (
    EpisodeConfig,
    Episodes,
    Noting,
    act_on,
    joined,
    kept,
)
from racines_envs.agents.memory.eyes import Eyes
from racines_envs.agents.memory.learner import MemoryConfig, MemoryLearner
from racines_models.networks.recall import RecallNetwork
from racines_models.protocol import Run
from racines_models.training.checkpoint import discard_checkpoint
from racines_models.training.trainer import train
from racines_models.weights import load_network, save_weights

DONE = "done"
"""Folder of a round: its weights once it has ended."""
Make = Callable[[Any, Any, RecallNetwork | None], Noting]


def learn(
    config: MemoryConfig, run: Run, make: Make, eyes: Eyes
) -> tuple[RecallNetwork, list[dict[str, Any]]]:
    """Train the network, all rounds; return it, and what is told of each round."""
    store = Path(config.store) if config.store else run.folder / "episodes"
    if run.resume is False:
        discard(run, config.rounds)

    def acted(patients: Sequence[int], network: RecallNetwork | None, who: str) -> Episodes:
        # Hearts lie on the CPU, and so does who acts on them.
        recalls = None if network is None else deepcopy(network).cpu()
        agent = make(config, deepcopy(eyes.network).cpu(), recalls)
        told = {"world": PATIENTS_VERSION, "eyes": eyes.sha256, "seed": run.seed, "by": who}
        # Without the setting, episodes are those that folders of before hold.
        told |= asdict(config.acts) | ({"bounded": True} if config.bounded else {})
        state = agent, config.acts, run.seed, store / recipe_digest(told)[:16]
        if config.processes > 1:
            exhaust(of_each(_act, state, patients, "episodes", run.progress, config.processes))
        return joined(list(of_each(_acted, state, patients, "episodes", run.progress)))

    held = acted(seeds_of("validation")[: config.validation_patients], None, "servo")
    own = acted(config.trained_on, None, "servo")
    learner = MemoryLearner(config, own, held, run.seed, eyes.sha256)
    rounds = [_round(learner, run)]
    for turn in range(1, config.rounds + 1):
        network = learner.network.eval()
        by = recipe_digest(learner.identity)
        own = joined([own, acted(config.met_in(turn), network, by)])
        started = network.train()
        learner = MemoryLearner(config, own, held, run.seed, eyes.sha256, started, turn)
        rounds.append(_round(learner, replace(run, folder=_folder(run, turn))))
    return learner.network, rounds


def _act(state: tuple[Noting, EpisodeConfig, int, Path], patient: int) -> None:
    _acted(state, patient)


def _acted(state: tuple[Noting, EpisodeConfig, int, Path], patient: int) -> Episodes:
    """Return an agent's episodes on a train patient, from the folder or by acting there."""
    agent, acts, seed, folder = state
    return kept(folder / f"{patient}.safetensors", lambda: act_on(agent, patient, acts, seed))


def of_episodes(figures: dict[str, Any]) -> dict[str, Any]:
    """Return a training's figures, whose examples are episodes, by the name of what they count."""
    return {name.replace("images", "episodes"): each for name, each in figures.items()}


def discard(run: Run, rounds: int) -> None:
    """Remove what only a run under way needs."""
    for turn in range(rounds + 1):
        discard_checkpoint(_folder(run, turn))
        shutil.rmtree(_folder(run, turn) / DONE, ignore_errors=True)


def _folder(run: Run, turn: int) -> Path:
    return run.folder / f"round-{turn}" if turn else run.folder


def _round(learner: MemoryLearner, run: Run) -> dict[str, Any]:
    """Train a round, or read what it came to before the run was killed."""
    done = run.folder / DONE / recipe_digest(learner.identity)[:16]
    if (done / "round.json").is_file():
        load_network(done / "network.safetensors", learner.network, "train it anew")
        return json.loads((done / "round.json").read_text(encoding="utf-8"))
    told = {"training": of_episodes(train(learner, None, learner.training, run, learner))}
    told |= {"history": learner.history, "frames": learner.frames}
    done.mkdir(parents=True, exist_ok=True)
    save_weights(done / "network.safetensors", learner.network.state_dict())
    write_json(done / "round.json", told)
    return told
