"""Attention over a scout's frames: the contract, what it learns, and what cannot be a scout."""

from dataclasses import replace

import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import parameters_to_pose
from racines_data.patients.scouts import FRAMES
from racines_data.store.scouts import RUN, MadeStore
from racines_models.adapting import adapted
from racines_models.generators.mean_image import MeanImage
from racines_models.generators.nearest_pose import NearestPose
from racines_models.generators.scout_attention import (
    ScoutAttention,
    ScoutAttentionConfig,
    known,
)
from racines_models.networks.scale import pixel_side
from racines_models.protocol import Adapting, Run
from racines_models.testing import GeneratorContract
from racines_models.training.episodes import EpisodeCourse, asked_of, scouts_of
from racines_models.training.objective import Training
from tests.models.conftest import FakeStore, pictures, random_parameters

pytestmark = pytest.mark.usefixtures("scouts_once")
TINY = ScoutAttentionConfig(
    width=8, frames=4, training=Training(images=32, batch_size=16, precision="fp32")
)


class FakeScouts(MadeStore):
    """Scouts and what is asked for, of pictures that follow the pose; the test split is asked."""

    config = "scouts"

    def __init__(self, train: int = 3):
        cases = train + 1
        parameters = random_parameters(cases * RUN, 1)
        self._hold(pictures(parameters), parameters, list(range(1, cases + 1)), RUN)
        self._splits = {"train": [0, train * RUN], "validation": [train * RUN, cases * RUN]}
        self._splits["test"] = [train * RUN + FRAMES, cases * RUN]
        self.manifest = {"source": "scouts", "version": "0.0.1", "digest": "d" * 9}


@pytest.fixture(scope="module")
def store():
    return FakeScouts()


def scout_of(store, case=3):
    return tuple(part[0] for part in scouts_of(store, torch.tensor([case])))


class TestScoutAttention(GeneratorContract):
    generator_class = ScoutAttention
    config = TINY

    def met(self, generator, store):
        return generator.adapt(*scout_of(store), 0)

    def test_its_scout_decides(self, store, tmp_path):
        """Another scout changes the images, the same one does not, and the original stays."""
        generator, poses = self.fitted(store, tmp_path), self.parameters(store)
        mine = generator.generate(poses, 0)
        other = generator.adapt(*scout_of(store, 0), 0)
        assert not torch.equal(other.generate(poses, 0), mine)
        assert torch.equal(generator.generate(poses, 0), mine)
        assert torch.equal(other.adapt(*scout_of(store), 9).generate(poses, 0), mine)
        assert generator.card.adapts and isinstance(generator, Adapting)

    def test_where_a_patient_lies_counts_for_nothing(self, store, tmp_path):
        """Scout and poses moved together give the same images, but for rounding."""
        generator, poses = self.fitted(store, tmp_path), self.parameters(store)
        # It begins with what the frames show; now what it has looked at goes on to the image.
        torch.manual_seed(0)
        for name, weight in generator.net("painter").named_parameters():
            if "leave" in name:
                torch.nn.init.normal_(weight, std=0.05)
        images, parameters = scout_of(store)
        moved, there = parameters.clone(), poses.clone()
        for each in (moved, there):
            each[:, 6:8] += torch.tensor([0.03, -0.05])
        first = generator.generate(poses, 0).int()
        again = generator.adapt(images, moved, 0).generate(there, 0).int()
        assert (first - again).abs().float().mean() < 0.05
        alone = generator.generate(there, 0).int()
        assert (first - alone).abs().float().mean() > 1.0, "poses alone are others"

    def test_grain_adds_what_the_deviation_says(self, store, tmp_path):
        generator, poses = self.fitted(store, tmp_path), self.parameters(store)
        rough = ScoutAttention(ScoutAttentionConfig(width=8, frames=4, grain=1.0))
        rough.nets, rough.known, rough.frames = generator.nets, generator.known, generator.frames
        smooth, rough = (each.generate(poses, 0).float() for each in (generator, rough))
        assert (rough - smooth).abs().mean() > 0.1


def test_nothing_is_drawn_before_the_patient_is_met(store, tmp_path):
    generator = ScoutAttention(TINY)
    generator.fit(store, Run(tmp_path, progress=False))
    with pytest.raises(RacinesError, match=r"no scout of this patient: call adapt\("):
        generator.generate(store.parameters[:2], 0)


@pytest.mark.thorough
def test_it_learns_to_draw(store, tmp_path):
    """What it draws of a patient that it learns from comes nearer to the truth."""
    images, parameters = scout_of(store, 0)
    truth, asked = asked_of(store, 0)

    def error(seen: int) -> float:
        training = Training(images=seen, batch_size=16, precision="fp32")
        config = replace(TINY, training=training, learning_rate=4e-3)
        generator = ScoutAttention(config)
        generator.fit(store, Run(tmp_path / str(seen), progress=False))
        drawn = generator.adapt(images, parameters, 0).generate(asked, 0)
        return float((drawn.float() - truth.float()).abs().mean())

    little, more = error(16), error(480)
    assert more < 0.85 * little, (little, more)


def test_how_large_a_pixel_is_reaches_what_is_known():
    for side in (0.0016, 0.0022):
        images, parameters = solid(side)
        found = known((images * 255).round().to(torch.uint8), parameters)
        assert abs(float(found.pixel) / side - 1.0) < 0.08


def test_it_learns_from_scouts_alone(tmp_path):
    frames = FakeStore()
    frames.config = "frames"
    with pytest.raises(RacinesError, match="'frames' has no scouts .* --tier patients"):
        ScoutAttention(TINY).fit(frames, Run(tmp_path, progress=False))


@pytest.mark.parametrize("cls", [ScoutAttention, NearestPose])
@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda images, poses, least: (images[: least - 1], poses[: least - 1]),
         r"has \d+ frames and adapt needs \d+"),
        (lambda images, poses, least: (images, poses[:-1]), "64 images and 63 poses"),
        (lambda images, poses, least: (images, poses * torch.nan), "is not finite"),
        (lambda images, poses, least: (images.float(), poses), "give uint8"),
    ],
    ids=["few", "counts", "nan", "floats"],
)  # fmt: skip
def test_what_is_no_scout_is_refused(store, cls, spoil, message):
    images, poses = spoil(*scout_of(store), cls.scout)
    with pytest.raises(RacinesError, match=message):
        cls().adapt(images, poses, 0)


def test_who_does_not_adapt_draws_as_ever(store, tmp_path):
    generator = MeanImage()
    generator.fit(store, Run(tmp_path, progress=False))
    assert adapted(generator, *scout_of(store), 0) is generator and not generator.card.adapts


def test_retrieval_finds_the_frames_of_the_scout(store):
    images, poses = scout_of(store)
    met = NearestPose().adapt(images, poses, 0)
    assert torch.equal(met.generate(poses, 0), images) and met.card.adapts


def test_episodes_are_a_function_of_seed_and_position(store):
    def episodes(seed, start):
        training = Training(images=64, batch_size=16)
        return list(EpisodeCourse(store, training, seed, "cpu", lambda *_: {}).batches(start, 64))

    whole, rest, other = episodes(3, 0), episodes(3, 32), episodes(4, 0)
    for one, two in zip(whole[2:], rest, strict=True):
        assert all(torch.equal(a, b) for a, b in zip(one, two, strict=True))
    assert not torch.equal(whole[0].images, other[0].images)
    for episode in whole:  # what is asked for is of the patient whose scout is shown
        rows = [store.parameters.eq(each).all(1).nonzero().item() for each in episode.parameters]
        assert [row // RUN for row in rows] == episode.cases[episode.owner].tolist()
        assert all(row % RUN >= FRAMES for row in rows)
        assert all(len(set(rows[i : i + 8])) == 8 for i in (0, 8))


def test_a_batch_is_whole_patients(store, tmp_path):
    config = ScoutAttentionConfig(width=8, training=Training(images=32, batch_size=12))
    with pytest.raises(RacinesError, match="batch_size 12: give a multiple of 8"):
        ScoutAttention(config).fit(store, Run(tmp_path, progress=False))


@pytest.mark.parametrize("change", [{"width": 12}, {"frames": 3}, {"grain": 1.5}])
def test_impossible_settings_are_refused(change):
    with pytest.raises(RacinesError, match="scout-attention"):
        ScoutAttentionConfig(**change)


def solid(side: float, pixels: int = 128) -> tuple[torch.Tensor, torch.Tensor]:
    """Return (64, S, S) slices of one solid, whose pixels are so many m at 128, and their poses."""
    generator = torch.Generator().manual_seed(0)
    parameters = random_parameters(FRAMES, 5)
    pose = parameters_to_pose(parameters)
    centres = torch.rand(24, 3, generator=generator) * 0.12 - 0.06
    centres = centres + torch.tensor([0.49, 0.0, -0.04])
    fold = 128 // pixels
    middle = (torch.arange(pixels) + 0.5) * fold
    axial, lateral = torch.meshgrid(middle * side, (middle - 64.0) * side, indexing="ij")
    images = []
    for position, rotation in zip(*pose, strict=True):
        places = position[:, None, None] + rotation[:, 0, None, None] * lateral
        places = places + rotation[:, 2, None, None] * axial
        apart = (places - centres[:, :, None, None]).square().sum(1)
        images.append((-apart / 0.018**2).exp().sum(0).clamp(0.01, 1.0))
    return torch.stack(images), parameters


def test_the_side_of_a_pixel_is_read_from_posed_frames():
    """Slices of one solid tell how large their pixels are."""
    for side in (0.0016, 0.0022):
        images, parameters = solid(side, 64)
        assert abs(pixel_side(images, parameters_to_pose(parameters)) / side - 1.0) < 0.06
