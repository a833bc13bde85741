"""The flow on top of a scout: the contract, where it copies and where it draws, its members."""

from dataclasses import replace

import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import parameters_to_pose
from racines_models.generators.scout_attention import ScoutAttention
from racines_models.generators.scout_flow import ScoutFlow, ScoutFlowConfig
from racines_models.networks.texturing import closest
from racines_models.protocol import Run
from racines_models.testing import GeneratorContract
from racines_models.training.episodes import EpisodeCourse
from racines_models.training.objective import Training
from tests.models.generators.test_scout_attention import TINY as PAINTER
from tests.models.generators.test_scout_attention import FakeScouts, scout_of

pytestmark = pytest.mark.usefixtures("scouts_once")
SEED = 3
"""The contract's."""
TINY = ScoutFlowConfig(
    width=8, frames=4, texture=8, steps=2,
    training=Training(images=32, batch_size=16, precision="fp32"),
)  # fmt: skip


@pytest.fixture(scope="module")
def store():
    return FakeScouts()


@pytest.fixture(scope="module")
def painter(store, tmp_path_factory):
    """Return the folder of a run of scout-attention."""
    folder = tmp_path_factory.mktemp("painter")
    ScoutAttention(PAINTER).fit(store, Run(folder, SEED, progress=False))
    return folder


class TestScoutFlow(GeneratorContract):
    generator_class = ScoutFlow
    config = TINY

    @pytest.fixture(autouse=True)
    def members(self, painter):
        type(self).config = replace(TINY, members=str(painter))

    def met(self, generator, store):
        return generator.adapt(*scout_of(store), 0)

    def test_without_grain_it_is_the_expected_image(self, store, tmp_path, painter):
        generator, poses = self.fitted(store, tmp_path), self.parameters(store)
        smooth = ScoutFlow(replace(self.config, grain=0.0))
        smooth.nets, smooth.known, smooth.frames = generator.nets, generator.known, generator.frames
        expected = self.met(ScoutAttention.load(painter), store).generate(poses, 0)
        assert torch.equal(smooth.generate(poses, 0), expected)
        assert not torch.equal(generator.generate(poses, 0), expected)

    def test_each_seed_is_another_sample_of_one_expected_image(self, store, tmp_path):
        """What seeds change are deviations: their mean over many is small beside them."""
        generator, poses = self.fitted(store, tmp_path), self.parameters(store)[:2]
        drawn = generator.generate(poses.repeat(24, 1), torch.arange(48))
        many = drawn.float().unflatten(0, (24, 2))
        lit = many.std(0) > 0.0
        apart = (many.mean(0)[lit] - many[0][lit]).abs().mean()
        halves = (many[:12].mean(0)[lit] - many[12:].mean(0)[lit]).abs().mean()
        assert float(apart) > 2.0 * float(halves) > 0.0


@pytest.mark.thorough
def test_it_learns_the_texture(store, tmp_path, painter):
    """It foresees better what its patients show beside the expected images, at all times."""

    def loss(seen: int) -> float:
        training = Training(images=seen, batch_size=16, precision="fp32", ema=0.8)
        config = replace(TINY, members=str(painter), training=training, learning_rate=4e-3)
        generator = ScoutFlow(config)
        generator.fit(store, Run(tmp_path / str(seen), SEED, progress=False))
        generator.store = store
        generator.prepare(store)
        (episode,) = EpisodeCourse(store, training, 99, "cpu", lambda *_: {}).batches(0, 16)
        return float(next(generator.updates(generator.nets, episode)).loss.detach())

    little, more = loss(16), loss(160)
    assert more < 0.8 * little, (little, more)


def test_a_frame_of_the_scout_itself_is_closest(store):
    """At the pose of a frame that frame is shown, in its own plane, all inside."""
    generator = ScoutAttention(PAINTER).adapt(*scout_of(store), 0)
    assert generator.known is not None and generator.frames is not None
    images, poses = scout_of(store)
    some = torch.tensor([0, 5, 40])
    frames = images.unsqueeze(0).float() / 255.0
    owner = torch.zeros(3, dtype=torch.int64)
    near = closest(generator.known, frames, owner, parameters_to_pose(poses[some]))
    inside = (generator.known.lit > 0) & (near.inside[:, 0] > 0.99)
    assert float(near.off[:, 0][inside].abs().max()) < 1e-6
    assert torch.allclose(near.shown[:, 0][inside], frames[0, some][inside], atol=1e-3)
    assert float(near.distances[:, 0].max()) < 1e-3
    both = inside & (near.inside[:, 1] > 0.99)
    assert (near.off[:, 1].abs() >= near.off[:, 0].abs())[both].all()


def test_it_goes_on_from_a_training_of_its_seed(store, tmp_path, painter):
    config = replace(TINY, members=str(painter))
    with pytest.raises(RacinesError, match=rf"no training of seed 4 \(seeds {SEED}\).*repeats"):
        ScoutFlow(config).fit(store, Run(tmp_path, 4, progress=False))
    with pytest.raises(RacinesError, match=r"scout-flow.width: 16, and that of .* is 8: give 8"):
        ScoutFlow(replace(config, width=16)).fit(store, Run(tmp_path, SEED, progress=False))
    with pytest.raises(RacinesError, match="no expected images here; train it with `racines train"):
        away = replace(config, members="nobody")
        ScoutFlow(away).fit(store, Run(tmp_path, SEED, progress=False))
    assert not list(tmp_path.glob("*.safetensors"))


def test_a_run_tells_whose_expected_images_it_goes_on_from(store, tmp_path, painter):
    """Another painter makes another run: it is not continued with half of each."""
    generator = ScoutFlow(replace(TINY, members=str(painter)))
    generator.seed, generator.data = SEED, {}
    generator.nets = generator.build()
    before = generator.identity
    generator.prepare(store)
    assert generator.sha256 and generator.identity != before


@pytest.mark.parametrize("change", [{"texture": 12}, {"steps": 0}, {"spacing": 0.0}, {"width": 9}])
def test_impossible_settings_are_refused(change):
    with pytest.raises(RacinesError, match=r"scout-(flow|attention)"):
        ScoutFlowConfig(**change)
