"""The ceiling scans the dataset's own phantom again, and only that."""

from dataclasses import asdict

import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.phantom.config import PHANTOM_VERSION, BlockConfig, PhantomConfig
from racines_data.phantom.model import shared_phantom
from racines_models.generators.noise_ceiling import NoiseCeiling
from racines_models.protocol import Run
from racines_models.scores.metrics import ssim
from racines_models.testing import GeneratorContract
from tests.models.conftest import FakeStore

COARSE = PhantomConfig(block=BlockConfig(voxel=0.004))


@pytest.fixture(scope="module")
def store():
    """Frames that the coarse phantom has given, with the recipe that says so."""
    store = FakeStore()
    part = {"phantom": PHANTOM_VERSION, "acquisition": {"phantom": asdict(COARSE)}}
    store.manifest["recipe"] = {"settings": part}
    store.images = shared_phantom(COARSE).generate(store.parameters, 99)
    return store


class TestNoiseCeiling(GeneratorContract):
    generator_class = NoiseCeiling

    def test_only_noise_is_left(self, store, tmp_path):
        """Its images are far nearer to the frames than those of a pose 8 mm aside."""
        generator, rows = self.fitted(store, tmp_path), store.split_indices("test")
        aside = store.parameters[rows].clone()
        aside[:, 6] += 0.008
        again = ssim(generator.generate(store.parameters[rows], 0), store.images[rows])
        beside = ssim(generator.generate(aside, 0), store.images[rows])
        assert (1.0 - again.mean()) < 0.5 * (1.0 - beside.mean())
        assert not torch.equal(generator.generate(aside, 0), generator.generate(aside, 1))


@pytest.mark.parametrize(
    ("change", "message"),
    [({"recipe": {}, "source": "tracked"}, "source is tracked"), ("0.0.1", "of phantom 0.0.1")],
    ids=["tracked", "version"],
)
def test_another_scene_is_refused(store, tmp_path, change, message):
    other = FakeStore()
    settings = store.manifest["recipe"]["settings"]
    other.manifest |= {"recipe": {"settings": settings | {"phantom": change}}}
    if isinstance(change, dict):
        other.manifest |= change
    with pytest.raises(RacinesError, match=message):
        NoiseCeiling().fit(other, Run(tmp_path, progress=False))


def test_a_model_of_another_phantom_is_refused(store, tmp_path, monkeypatch):
    NoiseCeiling().fit(store, Run(tmp_path, progress=False))
    monkeypatch.setattr("racines_models.generators.noise_ceiling.PHANTOM_VERSION", "9.9.9")
    with pytest.raises(RacinesError, match="made of phantom"):
        NoiseCeiling.load(tmp_path)
