"""`training.compile`: the same training to a rounding, and weights by the same names."""

import dataclasses
import os
import shutil

import pytest
import torch
from safetensors.torch import load_file
from torch._inductor import cpp_builder

from racines_data.errors import RacinesError
from racines_models.generators.vae_gan import VaeGan, VaeGanConfig
from racines_models.protocol import Run
from racines_models.training.objective import Training
from tests.models.conftest import FakeStore

APART = 2e-3
"""Relative difference of losses that is a rounding, after three steps: batch norms add in another
order when compiled, by which a pass differs by up to 2e-4, and Adam's first steps amplify that."""
CONFIG = VaeGanConfig(
    width=2, encoder_width=2, discriminator_width=2, latent=4, embedding=4,
    training=Training(images=24, batch_size=8, precision="fp32", log_every=8, sample_every=24),
)  # fmt: skip


def config(**training) -> VaeGanConfig:
    return dataclasses.replace(CONFIG, training=dataclasses.replace(CONFIG.training, **training))


def fit(folder, **training):
    generator = VaeGan(config(**training))
    return generator, generator.fit(FakeStore(train=60), Run(folder, device="cpu", progress=False))


@pytest.mark.thorough  # a minute and a half of compiling
@pytest.mark.skipif(not shutil.which(os.environ.get("CXX", "g++")), reason="needs a C++ compiler")
def test_a_compiled_training_is_the_same_to_a_rounding(tmp_path, monkeypatch):
    calls, compile = [], torch.compile
    monkeypatch.setattr(torch, "compile", lambda *a, **k: calls.append(a) or compile(*a, **k))
    _, plain = fit(tmp_path / "plain")
    assert not calls
    generator, compiled = fit(tmp_path / "compiled", compile=True)
    assert len(calls) == len(generator.modules()) == 3
    assert compiled["losses"] == pytest.approx(plain["losses"], rel=APART)
    one, other = (load_file(tmp_path / f"{way}/model.safetensors") for way in ("plain", "compiled"))
    assert {name: each.shape for name, each in one.items()} == {
        name: each.shape for name, each in other.items()
    }
    again, drawn = VaeGan.load(tmp_path / "compiled"), torch.zeros(2, 12)
    assert torch.equal(again.generate(drawn, 0), generator.generate(drawn, 0))
    fit(tmp_path / "after")
    assert len(calls) == 3, "a later training is compiled by its own setting alone"


def test_no_compiler_is_told_before_anything_is_trained(tmp_path, monkeypatch):
    cpp_builder.cpp_compiler_search.cache_clear()
    monkeypatch.setattr("torch._inductor.config.cpp.cxx", (None, str(tmp_path / "no-compiler")))
    with pytest.raises(RacinesError, match="no C\\+\\+ compiler was found: install one"):
        fit(tmp_path / "run", compile=True)
    cpp_builder.cpp_compiler_search.cache_clear()
    assert not (tmp_path / "run" / "model.safetensors").exists()
