"""Mistakes in a generator of one's own: one line that says what to give, before hours are lost."""

import sys
from types import ModuleType

import pytest
import torch
from torch import nn

from racines_data.errors import RacinesError
from racines_data.store.frames import open_store
from racines_models.contract import ContractError
from racines_models.generators.base import BaseGenerator
from racines_models.generators.mean_image import MeanImage
from racines_models.protocol import Run
from racines_models.registry import generator_class


class Plain(BaseGenerator):
    """Draws the mean of the first frames."""

    name, title, summary, source = "plain", "Plain", "The mean of some frames.", "none"
    Config, holds = MeanImage.Config, ("image",)

    def learn(self, store, run):
        self.held = {"image": store.images[:8].float().mean(0).byte()}
        return {"images": 8}

    def draw(self, parameters, seed):
        return self.held["image"].repeat(len(parameters), 1, 1)


DRAWN = {
    "floats": (lambda image: image.float() / 255, "a tensor of torch.float32"),
    "an axis of channels": (lambda image: image[:, None], r"shape \(\d+, 1, 128, 128\)"),
    "half the size": (lambda image: image[:, ::2, ::2], r"shape \(\d+, 64, 64\)"),
    "one image for all": (lambda image: image[0], r"shape \(128, 128\)"),
    "an array": (lambda image: image.numpy(), "ndarray"),
}


@pytest.mark.parametrize("mistake", DRAWN)
def test_what_is_drawn_is_refused_by_clause_and_what_was_learned_stays(
    tiny_root, tmp_path, mistake
):
    change, said = DRAWN[mistake]

    class Wrong(Plain):
        def draw(self, parameters, seed):
            return change(super().draw(parameters, seed))

    with pytest.raises(ContractError, match=rf"clause G1 .* Wrong\.draw gave .*{said}"):
        Wrong().fit(open_store(tiny_root), Run(tmp_path, progress=False))
    assert Plain.load(tmp_path).held["image"].any()


@pytest.mark.parametrize("word", ["title", "summary", "source"])
def test_a_word_of_the_card_that_is_missing_is_told_before_it_learns(tiny_root, tmp_path, word):
    class Silent(Plain):
        def learn(self, store, run):
            raise AssertionError("it has learned")

    setattr(Silent, word, None)
    with pytest.raises(RacinesError, match=f"generator plain: Silent lacks {word}"):
        Silent().fit(open_store(tiny_root), Run(tmp_path, progress=False))
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize(
    "learned, held, said",
    [
        (None, {}, r"Silent\.learn gave NoneType: give a mapping"),
        ({"loss": torch.ones(2)}, {}, r"Silent\.learn: metrics are numbers and texts: .*Tensor"),
        ({}, {"net": nn.Linear(1, 1)}, r"Silent\.tensors: 'net' is Linear: give tensors"),
    ],
)
def test_what_learn_and_tensors_give_is_told(tiny_root, tmp_path, learned, held, said):
    class Silent(Plain):
        def learn(self, store, run):
            self.held = held
            return learned

    with pytest.raises(RacinesError, match=said):
        Silent().fit(open_store(tiny_root), Run(tmp_path, progress=False))
    saved = (tmp_path / "model.safetensors").is_file()
    assert saved == ("tensors" not in said)  # what was learned stays


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    made = ModuleType("own_generators")
    monkeypatch.setitem(sys.modules, "own_generators", made)
    return made


@pytest.mark.parametrize(
    "name, said",
    [
        ("nearest-pose", "name 'nearest-pose' is a registered generator's: give another"),
        ("My Generator", "name 'My Generator': its folder's: give one of"),
        ("../up", r"name '\.\./up': its folder's"),
        (7, "name 7: its folder's"),
    ],
)
def test_a_name_that_is_anothers_or_no_folders_is_refused(module, name, said):
    module.Own = type("Own", (Plain,), {"name": name})
    with pytest.raises(RacinesError, match=f"own_generators:Own: {said}"):
        generator_class("own_generators:Own")


def test_ones_own_name_and_a_registered_class_are_taken(module):
    module.Own = Plain
    assert generator_class("own_generators:Own") is Plain
    there = f"{MeanImage.__module__}:MeanImage"
    assert generator_class(there) is generator_class("mean-image") is MeanImage


def test_a_class_that_lacks_a_method_is_told_before_it_is_made(module):
    module.Own = type("Own", (Plain,), {"learn": BaseGenerator.learn})
    module.Own.__abstractmethods__ = frozenset({"learn"})
    with pytest.raises(RacinesError, match="own_generators:Own: generator lacks the methods learn"):
        generator_class("own_generators:Own")
