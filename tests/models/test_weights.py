"""The one pair of save and load: no pickle, whole files, float32 in memory."""

import pytest
import torch
from torch import nn

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_models.weights import load_network, load_weights, publish, save_weights


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


def run_of(folder, weight):
    save_weights(folder / "policy.safetensors", {"net.weight": weight, "net.bias": torch.rand(64)})
    (folder / "config.json").write_text("{}")
    return folder


def test_published_in_steps_a_weight_is_half_a_step_from_what_it_was(tmp_path):
    scale = torch.logspace(-3, 1, 64).unsqueeze(1)
    weight = torch.randn(64, 96, generator=torch.Generator().manual_seed(0)) * scale
    weight[5] = 0.0
    run = run_of(tmp_path / "run", weight)
    sizes = {}
    for form in ("float16", "int8"):
        told = publish(run, tmp_path / form, form)["weights_files"]
        assert told["dtype"] == form
        sizes[form] = told["files"]["policy.safetensors"]["bytes"]
    assert sizes["int8"] < 0.6 * sizes["float16"]
    found = load_weights(tmp_path / "int8/policy.safetensors")
    assert set(found) == {"net.weight", "net.bias"}
    assert torch.equal(found["net.bias"], load_weights(run / "policy.safetensors")["net.bias"])
    step = weight.abs().amax(1, keepdim=True) / 127
    assert bool(((found["net.weight"] - weight).abs() <= 0.501 * step).all())
    network = nn.ModuleDict({"net": nn.Linear(96, 64)})
    load_network(tmp_path / "int8/policy.safetensors", network, "train again")


def test_other_forms_and_weights_that_do_not_fit_are_refused(tmp_path):
    run = run_of(tmp_path / "run", torch.full((64, 96), torch.nan))
    with pytest.raises(RacinesError, match="'int4': weights are published as float16 or int8"):
        publish(run, tmp_path / "out", "int4")
    for form in ("float16", "int8"):
        with pytest.raises(RacinesError, match="policy.safetensors: net.weight is NaN"):
            publish(run, tmp_path / form, form)


def test_a_name_that_only_looks_like_a_step_is_a_tensor_of_its_own(tmp_path):
    wanted = {"clock": torch.rand(3), "clock.step": torch.rand(3)}
    save_weights(tmp_path / "model.safetensors", wanted)
    found = load_weights(tmp_path / "model.safetensors")
    assert all(torch.equal(found[key], each) for key, each in wanted.items()) and len(found) == 2
