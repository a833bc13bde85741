"""A servo's trainings: the first from the ways of others, each that follows from its own as well.

    frames of train patients -> network -> it acts on train patients -> what it saw beside them -> …

A training that has ended leaves its weights in the run's folder, so that a run which is killed goes
on with the round that it was in.
"""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from racines_data.digest import recipe_digest
from racines_data.files import write_json
from racines_data.patients.splits import seeds_of
from racines_envs.agents.protocol import Agent
from racines_envs.agents.servo.frames import kept, shard
from racines_envs.agents.servo.learner import Bank, ServoConfig, ServoLearner
from racines_envs.agents.servo.visits import visit
from racines_models.networks.servo import ServoNetwork
from racines_models.protocol import Run
from racines_models.training.checkpoint import discard_checkpoint
from racines_models.training.trainer import train
from racines_models.weights import load_network, save_weights


def learn(
    config: ServoConfig, run: Run, make: Callable[[ServoConfig, ServoNetwork], Agent]
) -> tuple[ServoNetwork, list[dict[str, Any]]]:
    """Train the network, all rounds; return it, and what is told of each round."""
    where = Path(config.store) if config.store else run.folder / "frames"

    def bank(split: str, patients: int) -> Bank:
        def drawn(patient: int):
            return shard(patient, config.frames, where)

        return Bank(seeds_of(split)[:patients], config.frames.frames, drawn)

    own, held = bank("train", config.patients), bank("validation", config.validation_patients)
    if run.resume is False:
        discard(run, config.visits.rounds)
    learner = ServoLearner(config, own, held, run.seed)
    rounds = [_round(learner, run)]
    for turn in range(1, config.visits.rounds + 1):
        agent = make(config, learner.network.eval())
        visited = _visited(agent, learner.identity, config, run, turn)
        network = learner.network.train()
        learner = ServoLearner(config, own, held, run.seed, network, visited, turn)
        rounds.append(_round(learner, replace(run, folder=_folder(run, turn))))
    return learner.network, rounds


def discard(run: Run, rounds: int) -> None:
    """Remove what only a run under way needs."""
    for turn in range(rounds + 1):
        discard_checkpoint(_folder(run, turn))
        shutil.rmtree(_folder(run, turn) / DONE, ignore_errors=True)
        shutil.rmtree(_folder(run, turn) / VISITED, ignore_errors=True)


DONE, VISITED = "done", "visited"
"""Folders of a round: its weights once it has ended, and what it learned from beside."""


def _folder(run: Run, turn: int) -> Path:
    return run.folder / f"round-{turn}" if turn else run.folder


def _visited(
    agent: Agent, identity: dict[str, Any], config: ServoConfig, run: Run, turn: int
) -> Bank:
    """Return a bank of what an agent sees, which is known by how it was trained."""
    folder = _folder(run, turn) / VISITED / recipe_digest(identity)[:16]
    visits = config.visits
    every = seeds_of("train")
    first = visits.patients * (turn - 1)
    seeds = [every[place % config.patients] for place in range(first, first + visits.patients)]

    def drawn(patient: int):
        path = folder / f"{patient}.safetensors"
        places = config.frames.places
        return kept(path, lambda: visit(agent, patient, places, visits, run.seed + turn))

    bank = Bank(seeds, visits.episodes * visits.steps, drawn)
    bank.holding(len(seeds))  # before the network that acts learns on
    return bank


def _round(learner: ServoLearner, run: Run) -> dict[str, Any]:
    """Train a round, or read what it came to before the run was killed."""
    done = run.folder / DONE / recipe_digest(learner.identity)[:16]
    if (done / "round.json").is_file():
        load_network(done / "network.safetensors", learner.network, "train it anew")
        return json.loads((done / "round.json").read_text(encoding="utf-8"))
    figures = train(learner, None, learner.training, run, learner)
    told = {"training": figures, "history": learner.history}
    done.mkdir(parents=True, exist_ok=True)
    save_weights(done / "network.safetensors", learner.network.state_dict())
    write_json(done / "round.json", told)
    return told
