"""Gradient steps as one graph: which batches it takes, and what a CPU does instead."""

import tensordict.nn
import torch
from tensordict import TensorDict

from racines_envs.agents.graphs import WARM_UP, replayed, set_rate


def batch(rows: int) -> TensorDict:
    return TensorDict({"x": torch.ones(rows, 2)}, batch_size=[rows])


def step(each: TensorDict) -> TensorDict:
    return TensorDict({"sum": each["x"].sum()})


def test_a_cpu_takes_the_step_itself():
    assert replayed(step, 4, "cpu") is step
    group = {"lr": 1.0}
    set_rate(group, 0.5, "cpu")
    assert group == {"lr": 0.5}


def test_batches_of_the_size_that_was_captured_go_through_the_graph(monkeypatch):
    replays = []

    class Graph:
        def __init__(self, taken, **settings):
            self.taken = taken
            assert settings["warmup"] == WARM_UP and settings["device"] == torch.device("cuda:1")

        def __call__(self, each: TensorDict) -> TensorDict:
            replays.append(len(each))
            return self.taken(each)

    monkeypatch.setattr(tensordict.nn, "CudaGraphModule", Graph)
    taken = replayed(step, 4, "cuda:1")
    assert [float(taken(batch(rows))["sum"]) for rows in (4, 3, 4)] == [8.0, 6.0, 8.0]
    assert replays == [4, 4]
