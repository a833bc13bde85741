"""The one pair of save and load: no pickle, whole files, float32 in memory."""

import pytest
import torch
from torch import nn

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_models.weights import load_network, load_weights, save_weights


def test_what_is_saved_comes_back_in_full_precision(tmp_path):
    path = tmp_path / "model.safetensors"
    wanted = {"turned": torch.rand(3, 2, requires_grad=True).mT, "half": torch.rand(4).half()}
    assert save_weights(path, wanted) == sha256_file(path)
    found = load_weights(path)
    assert torch.equal(found["turned"], wanted["turned"])
    assert torch.equal(found["half"], wanted["half"].float())
    assert list(tmp_path.iterdir()) == [path]


def test_a_pickle_is_refused_and_never_run(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (tmp_path / "ran").touch, ()

    path = tmp_path / "model.safetensors"
    torch.save({"weight": torch.ones(1), "bomb": Bomb()}, path)
    with pytest.raises(RacinesError, match="model.safetensors: cannot be read as .*; train again"):
        load_weights(path, remedy="train again")
    assert not (tmp_path / "ran").exists()


def test_file_and_remedy_are_named(tmp_path):
    path = tmp_path / "model.safetensors"
    with pytest.raises(RacinesError, match="model.safetensors: no such file; train again"):
        load_network(path, nn.Linear(2, 1), "train again")
    save_weights(path, nn.Linear(3, 1).state_dict())
    with pytest.raises(RacinesError, match="(?s)does not fit .*config.json: .*; train again"):
        load_network(path, nn.Linear(2, 1), "train again")
