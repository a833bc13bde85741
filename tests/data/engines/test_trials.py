"""Trainings as trials of Ray Tune: the same bytes, and a worker that dies costs its own only."""

import os
from pathlib import Path
from typing import Any

import pytest
import torch

from racines_data.engines import Trials
from racines_data.engines.local import LocalEngine
from racines_data.engines.ray import RayEngine
from racines_data.errors import RacinesError
from racines_models.protocol import Run
from racines_models.training.sets import FINISHED, Training, train_set
from racines_models.weights import save_weights


def work(folder: Path, task: str) -> tuple[str, int, str]:
    """Die at the first try of one task, always of another, and refuse a third."""
    first = folder / task
    if task == "refused":
        raise RacinesError("no grader in models/runs/grader")
    if task == "deadly" or (task == "dies" and not first.exists()):
        first.touch()
        os._exit(1)
    return task, os.getpid(), os.getcwd()


def made(engine: RayEngine, folder: Path, *tasks: str) -> dict[int, Any]:
    results: dict[int, Any] = {}
    engine.trials(work, folder, tasks, results.__setitem__, remedy="to go on")
    return results


@pytest.mark.thorough
def test_results_come_by_number_from_other_processes_in_the_callers_folder(
    engine: RayEngine, tmp_path: Path
):
    assert isinstance(engine, Trials) and not isinstance(LocalEngine(), Trials)
    results = made(engine, tmp_path, "a", "dies", "b")
    assert {number: each[0] for number, each in results.items()} == {0: "a", 1: "dies", 2: "b"}
    assert os.getpid() not in {each[1] for each in results.values()}
    assert {each[2] for each in results.values()} == {os.getcwd()}
    assert made(engine, tmp_path) == {}


@pytest.mark.thorough
def test_a_refusal_is_told_as_it_is_once_the_others_are_done(engine: RayEngine, tmp_path: Path):
    results: dict[int, Any] = {}
    with pytest.raises(RacinesError, match="^no grader in models/runs/grader$"):
        engine.trials(work, tmp_path, ["refused", "a"], results.__setitem__)
    assert [*results] == [1]


@pytest.mark.thorough
def test_what_kills_every_worker_does_not_go_on_for_ever(
    engine: RayEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("racines_data.engines.ray.TRIES", 2)
    with pytest.raises(RacinesError, match="was begun 2 times and its worker died each time: run"):
        made(engine, tmp_path, "deadly")


def learn(run: Run) -> dict[str, Any]:
    """Train a small network, by the seed and by nothing else."""
    torch.manual_seed(run.seed)
    network = torch.nn.Sequential(torch.nn.Linear(6, 32), torch.nn.ReLU(), torch.nn.Linear(32, 1))
    optimizer = torch.optim.AdamW(network.parameters(), lr=1e-2)
    for _ in range(50):
        x = torch.randn(64, 6)
        loss = (network(x).squeeze(1) - x.square().sum(1)).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    run.folder.mkdir(parents=True, exist_ok=True)
    return {"policy": save_weights(run.folder / "policy.safetensors", network.state_dict())}


def fit(run: Run) -> dict[str, Any]:
    """Go on from what is there; die at the first step of seed 4; learn in folder a alone."""
    run.folder.mkdir(parents=True, exist_ok=True)
    begun = run.folder / "begun"
    if run.seed == 4 and not begun.exists():
        begun.touch()
        os._exit(1)
    told = {"resumed": begun.exists(), "seed": run.seed, "process": os.getpid()}
    return told | (learn(run) if "a" in run.folder.parts else {})


def test_a_set_gives_the_same_policies_though_a_worker_died(
    engine: RayEngine, tmp_path: Path, capfd: pytest.CaptureFixture[str]
):
    two, one = Training(fit, Run(tmp_path / "a", 3), 2), Training(fit, Run(tmp_path / "b", 3), 1)
    both, alone = train_set([two, one], engine)
    learned = both["seeds"].values()
    told = [(m["seed"], m["resumed"]) for m in (*learned, alone)]
    assert told == [(3, False), (4, True), (3, False)]
    assert not [*tmp_path.rglob(FINISHED)]
    assert "racines: a worker died: its training goes on elsewhere" in capfd.readouterr().err
    here = [learn(run) for run in Training(learn, Run(tmp_path / "here", 3), 2).runs]
    assert [each["policy"] for each in learned] == [each["policy"] for each in here]
