"""Generators by name, by entry point of another package, and by module:Class."""

import sys
import textwrap
from pathlib import Path

import pytest
import torch

from racines_data.errors import RacinesError
from racines_models.protocol import Run
from racines_models.published import places
from racines_models.registry import (
    generator_class,
    generator_names,
    load_generator,
    weights_folder,
)
from tests.plugins.packages import install

THIRD_PARTY = '''
    from dataclasses import asdict, dataclass
    import json
    import torch
    from racines_models.protocol import Card

    @dataclass
    class Config:
        level: int = 70

    class Flat:
        """Written without our base class: the protocol alone."""
        name = "flat"
        Config = Config
        def __init__(self, config=None):
            self.config = config or Config()
        @property
        def card(self):
            return Card("flat", "Flat", "One gray.", "a test", False, 1, {}, asdict(self.config), 0)
        def fit(self, store, run):
            self.save(run.folder)
            return {}
        def generate(self, parameters, seed):
            return torch.full((len(parameters), 128, 128), self.config.level, dtype=torch.uint8)
        def save(self, folder):
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "config.json").write_text(json.dumps(asdict(self.config)))
        @classmethod
        def load(cls, folder, device="cpu"):
            return cls(Config(**json.loads((folder / "config.json").read_text())))

    class Half:
        name = "half"
'''


@pytest.fixture
def third_party(tmp_path, monkeypatch):
    """An installed package of somebody else, with an entry point."""
    (tmp_path / "their_generators.py").write_text(textwrap.dedent(THIRD_PARTY))
    install(tmp_path, "their_generators", {"racines.generators": {"flat": "their_generators:Flat"}})
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    sys.modules.pop("their_generators", None)


def test_ours_are_registered():
    assert {"mean-image", "nearest-pose", "vae-gan"} <= set(generator_names())
    for name in generator_names():
        assert generator_class(name).name == name


def test_unknown_name_lists_the_known():
    with pytest.raises(RacinesError, match="'vaegan'.*mean-image, .*vae-gan.*FILE.onnx"):
        generator_class("vaegan")


@pytest.mark.parametrize("spec", ["flat", "their_generators:Flat"])
def test_another_package_plugs_in(third_party, store, tmp_path, spec):
    cls = generator_class(spec)
    cls(cls.Config(level=9)).fit(store, Run(tmp_path / "run"))
    loaded = load_generator(spec, tmp_path / "run")
    assert torch.equal(loaded.generate(store.parameters[:2], 0).unique(), torch.tensor([9]).byte())
    assert ("flat" in generator_names()) and "flat" in _message(lambda: generator_class("nope"))


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("no_such_module:Thing", "cannot import no_such_module"),
        ("their_generators:Missing", "has no 'Missing'"),
        ("their_generators:Half", "lacks Config, card, fit, generate, save, load"),
    ],
)
def test_what_is_no_generator_is_refused(third_party, spec, message):
    with pytest.raises(RacinesError, match=message):
        generator_class(spec)


def test_folder_of_another_generator_is_refused(store, tmp_path):
    generator_class("mean-image")().fit(store, Run(tmp_path))
    with pytest.raises(RacinesError, match="holds mean-image, not nearest-pose"):
        load_generator("nearest-pose", tmp_path)


def _message(call) -> str:
    with pytest.raises(RacinesError) as caught:
        call()
    return str(caught.value)


def test_weights_of_a_generator_on_patients_are_its_runs_or_the_published_ones(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    places._tell.cache_clear()  # it is said once a process, and another test may have asked
    found = weights_folder("scout-attention")
    assert found == places.CHECKOUT / "models/weights/patients/scout-attention"
    assert "using the published" in capsys.readouterr().err
    own = Path("models/runs/patients/scout-attention")
    own.mkdir(parents=True)
    (own / "config.json").write_text("{}")
    assert weights_folder("scout-attention") == own
    assert weights_folder("scout-attention", "elsewhere") == Path("elsewhere")
    assert weights_folder("nearest-pose") == Path("models/runs/patients/nearest-pose"), "no weights"
