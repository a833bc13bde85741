"""A servo's trainings: the first from the ways of others, each that follows from its own as well.

    frames of train patients -> network -> it acts on train patients -> what it saw beside them -> …

A training that has ended leaves its weights in the run's folder, so that a run which is killed goes
on with the round that it was in.
"""

import json
import shutil
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

from racines_data.digest import recipe_digest
from racines_data.files import write_json
from racines_data.patients.splits import seeds_of
from racines_envs.agents.many import exhaust, of_each
from racines_envs.agents.servo.frames import FrameConfig, Frames, kept, shard
from racines_envs.agents.servo.learner import Bank, ServoConfig, ServoLearner
from racines_envs.agents.servo.visits import Reads, VisitConfig, visit
from racines_models.networks.servo import ServoNetwork
from racines_models.protocol import Run
from racines_models.training.checkpoint import discard_checkpoint
from racines_models.training.trainer import train
from racines_models.weights import load_network, save_weights


def learn(
    config: ServoConfig, run: Run, make: Callable[[ServoConfig, ServoNetwork], Reads]
) -> tuple[ServoNetwork, list[dict[str, Any]]]:
    """Train the network, all rounds; return it, and what is told of each round."""
    where = Path(config.store) if config.store else run.folder / "frames"

    def bank(split: str, patients: int) -> Bank:
        def drawn(patient: int):
            return shard(patient, config.frames, where, config.side)

        seeds = seeds_of(split)[:patients]
        return Bank(seeds, config.frames.frames, drawn, config.side, config.device)

    own, held = bank("train", config.patients), bank("validation", config.validation_patients)
    if run.resume is False:
        discard(run, config.visits.rounds)
    learner = ServoLearner(config, own, held, run.seed)
    if not _done(learner, run).is_dir():
        _draw(config, where, run)
    rounds = [_round(learner, run)]
    for turn in range(1, config.visits.rounds + 1):
        agent = make(config, deepcopy(learner.network).cpu())  # hearts lie on the CPU
        visited = _visited(agent, learner.identity, config, run, turn)
        network = learner.network.train()
        learner = ServoLearner(config, own, held, run.seed, network, visited, turn)
        rounds.append(_round(learner, replace(run, folder=_folder(run, turn))))
    return learner.network, rounds


def _draw(config: ServoConfig, where: Path, run: Run) -> None:
    """Draw all frames in several processes, if there are to be several."""
    seeds = [*seeds_of("validation")[: config.validation_patients]]
    seeds += seeds_of("train")[: config.patients]
    if config.processes > 1:
        state = config.frames, where, config.side
        exhaust(of_each(_drawn, state, seeds, "frames", run.progress, config.processes))


def _drawn(state: tuple[FrameConfig, Path, int], patient: int) -> None:
    frames, where, side = state
    shard(patient, frames, where, side)


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
    agent: Reads, identity: dict[str, Any], config: ServoConfig, run: Run, turn: int
) -> Bank:
    """Return a bank of what an agent sees, which is known by how it was trained."""
    folder = _folder(run, turn) / VISITED / recipe_digest(identity)[:16]
    visits = config.visits
    every = seeds_of("train")
    first = visits.patients * (turn - 1)
    seeds = [every[place % config.patients] for place in range(first, first + visits.patients)]

    state = agent, config.frames.places, visits, run.seed + turn, folder
    if config.processes > 1:
        exhaust(of_each(_go, state, seeds, "visits", run.progress, config.processes))

    def drawn(patient: int):
        return _went(state, patient)

    room, device = visits.episodes * visits.steps, config.device
    bank = Bank(seeds, room, drawn, config.side, device)
    bank.holding(len(seeds))  # before the network that acts learns on
    return bank


def _go(state: tuple[Reads, int, VisitConfig, int, Path], patient: int) -> None:
    _went(state, patient)


def _went(state: tuple[Reads, int, VisitConfig, int, Path], patient: int) -> Frames:
    """Return what an agent sees on a train patient, from the folder or by acting there."""
    agent, places, visits, seed, folder = state
    path = folder / f"{patient}.safetensors"
    return kept(path, lambda: visit(agent, patient, places, visits, seed))


def _done(learner: ServoLearner, run: Run) -> Path:
    """Return where a round's weights are once it has ended."""
    return run.folder / DONE / recipe_digest(learner.identity)[:16]


def _round(learner: ServoLearner, run: Run) -> dict[str, Any]:
    """Train a round, or read what it came to before the run was killed."""
    done = _done(learner, run)
    if (done / "round.json").is_file():
        load_network(done / "network.safetensors", learner.network, "train it anew")
        return json.loads((done / "round.json").read_text(encoding="utf-8"))
    figures = train(learner, None, learner.training, run, learner)
    told = {"training": figures, "history": learner.history}
    done.mkdir(parents=True, exist_ok=True)
    save_weights(done / "network.safetensors", learner.network.state_dict())
    write_json(done / "round.json", told)
    return told
