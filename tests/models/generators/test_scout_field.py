"""The field between a scout's frames: the contract, what voxels show, and where cells look."""

import copy
from dataclasses import replace

import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, parameters_to_pose, pose_to_parameters
from racines_data.patients.scouts import FRAMES
from racines_models.generators.scout_attention import known
from racines_models.generators.scout_field import ScoutField, ScoutFieldConfig
from racines_models.networks.scouting import ScoutNetwork
from racines_models.networks.volume import VOXEL, VOXELS, frame_of, gathered, looked_up
from racines_models.protocol import Run
from racines_models.testing import GeneratorContract
from racines_models.training.episodes import asked_of
from racines_models.training.objective import Training
from tests.models.generators.test_scout_attention import FakeScouts, scout_of, solid

pytestmark = pytest.mark.usefixtures("scouts_once")
TINY = ScoutFieldConfig(
    width=8, frames=4, prior=8, channels=8, fit=2,
    training=Training(images=32, batch_size=16, precision="fp32"),
)  # fmt: skip


@pytest.fixture(scope="module")
def store():
    return FakeScouts()


def own(generator):
    """Return a copy whose weights and settings a test may change."""
    generator = copy.copy(generator)
    generator.nets = copy.deepcopy(generator.nets)
    return generator


@pytest.fixture(scope="module")
def fitted(store, tmp_path_factory):
    """Return one that has met nobody."""
    generator = ScoutField(TINY)
    generator.fit(store, Run(tmp_path_factory.mktemp("field"), progress=False))
    return generator


class TestScoutField(GeneratorContract):
    generator_class = ScoutField
    config = TINY

    def met(self, generator, store):
        return generator.adapt(*scout_of(store), 0)

    def own(self, store, folder):
        """Return one whose weights a test may change."""
        return own(self.fitted(store, folder))

    def test_where_a_patient_lies_counts_for_nothing(self, store, tmp_path):
        """Scout and poses turned and moved together give the same images, but for rounding."""
        generator, poses = self.own(store, tmp_path), self.parameters(store)
        torch.manual_seed(0)
        for name, weight in generator.net("painter").named_parameters():
            if "leave" in name:
                torch.nn.init.normal_(weight, std=0.05)
        images, parameters = scout_of(store)
        generator = generator.adapt(images, parameters, 0)
        first = generator.generate(poses, 0).int()
        again = generator.adapt(images, moved(parameters), 0).generate(moved(poses), 0).int()
        assert (first - again).abs().float().mean() < 0.1
        alone = generator.generate(moved(poses), 0).int()
        assert (first - alone).abs().float().mean() > 1.0, "poses alone are others"

    def test_the_field_decides(self, store, tmp_path):
        """What is looked up in the field goes on to the image."""
        generator, poses = self.own(store, tmp_path), self.parameters(store)
        torch.manual_seed(0)
        torch.nn.init.normal_(generator.net("painter").painter.decoder.leave.weight, std=0.05)
        drawn = generator.generate(poses, 0)
        assert generator.field is not None
        generator.field = generator.field + 1.0
        assert not torch.equal(generator.generate(poses, 0), drawn)


def moved(parameters):
    """Return poses turned by a quarter about the vertical, and shifted."""
    pose = parameters_to_pose(parameters.double())
    turn = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]).double()
    there = Pose(pose.position @ turn.T + torch.tensor([0.03, -0.05, 0.01]), turn @ pose.rotation)
    return pose_to_parameters(there, parameters[:, :6].double()).float()


def test_voxels_show_the_solid_that_frames_pass():
    """Where frames of a solid pass, the gathered gray level is that of the solid."""
    side = 0.0018
    images, parameters = solid(side)
    scouts = known((images * 255).round().to(torch.uint8), parameters)
    scouts = scouts._replace(pixel=torch.tensor([side]))
    shown = gathered(scouts)[0]
    home = Pose(*(part[0] for part in frame_of(scouts.poses)))
    middle = (torch.arange(VOXELS) + 0.5) * VOXEL
    depth, off, across = torch.meshgrid(
        middle, middle - VOXELS * VOXEL / 2, middle - VOXELS * VOXEL / 2, indexing="ij"
    )
    places = torch.stack([across, off, depth], -1) @ home.rotation.T + home.position
    truth = gray_of_solid(places)
    passed = shown[0] > 1.0
    assert 0.02 < float(passed.float().mean()) < 0.9
    error = (shown[1] - truth)[passed].abs().mean()
    spread = (truth[passed] - truth[passed].mean()).abs().mean()
    assert float(error) < 0.2 * float(spread), (error, spread)


def gray_of_solid(places):
    """Return the gray level of `solid` at (…, 3) places, m."""
    centres = torch.rand(24, 3, generator=torch.Generator().manual_seed(0)) * 0.12 - 0.06
    centres = centres + torch.tensor([0.49, 0.0, -0.04])
    apart = (places.unsqueeze(-2) - centres).square().sum(-1)
    return (-apart / 0.018**2).exp().sum(-1).clamp(0.01, 1.0)


def test_cells_look_up_their_own_places():
    """Of a volume that holds its own coordinates, cells find where they lie."""
    torch.manual_seed(0)
    count = 3
    parameters = torch.cat([moved(solid(0.0018)[1][:count]), solid(0.0018)[1][:count]])
    pose = parameters_to_pose(parameters)
    home = Pose(*(part[[0, count]] for part in pose))
    middle = (torch.arange(VOXELS) + 0.5) * VOXEL
    depth, off, across = torch.meshgrid(
        middle, middle - VOXELS * VOXEL / 2, middle - VOXELS * VOXEL / 2, indexing="ij"
    )
    volume = torch.stack([across, off, depth]).expand(2, -1, -1, -1, -1).contiguous()
    cells, pixel = ScoutNetwork(8, 4).cells, torch.tensor([0.0016, 0.002]).repeat_interleave(count)
    found, about = looked_up(volume, home, pose, cells, pixel)
    for row in range(2 * count):
        own = Pose(*(part[row // count] for part in home))
        lateral, axial = cells * pixel[row]
        places = pose.position[row] + torch.stack(
            [
                lateral * pose.rotation[row, k, 0] + axial * pose.rotation[row, k, 2]
                for k in range(3)
            ],
            -1,
        )
        local = (places - own.position) @ own.rotation
        edge = VOXELS * VOXEL / 2 - VOXEL
        inside = (local - torch.tensor([0.0, 0.0, VOXELS * VOXEL / 2])).abs().amax(-1) < edge
        assert inside.float().mean() > 0.3
        apart = (found[row].permute(1, 2, 0) - local)[inside].abs().max()
        assert float(apart) < 1e-5
    assert torch.allclose(about[0], torch.tensor([0, 0, 0, 1, 0, 0, 0, 0, 1.0]), atol=1e-5)


def test_the_prior_is_learned(store, tmp_path):
    """Training moves the prior's weights, and what is drawn comes nearer to the truth."""
    images, parameters = scout_of(store, 0)
    truth, asked = asked_of(store, 0)

    def trained(seen: int):
        training = Training(images=seen, batch_size=16, precision="fp32")
        generator = ScoutField(replace(TINY, training=training, learning_rate=4e-3))
        generator.fit(store, Run(tmp_path / str(seen), progress=False))
        assert generator.shown is None, "nothing of the store stays"
        drawn = generator.adapt(images, parameters, 0).generate(asked, 0)
        error = float((drawn.float() - truth.float()).abs().mean())
        return error, next(generator.net("painter").prior.parameters()).detach()

    (little, first), (more, last) = trained(16), trained(160)
    assert more < 0.97 * little, (little, more)
    assert not torch.equal(first, last)


@pytest.mark.parametrize(
    ("change", "message"),
    [({"prior": 12}, "multiple of 8"), ({"channels": 4}, "multiple of 8"),
     ({"fit": -1}, "fit is 0 or more"), ({"fit_rate": 0.0}, "fit_rate is above 0")],
)  # fmt: skip
def test_impossible_settings_are_refused(change, message):
    with pytest.raises(RacinesError, match=rf"scout-field.*{message}"):
        ScoutFieldConfig(**change)


def test_a_field_is_fitted_to_the_scout(store, fitted):
    """Steps of fitting change the field, each scout's own; none leaves it as the prior says."""
    generator = own(fitted)
    torch.manual_seed(0)
    torch.nn.init.normal_(generator.net("painter").painter.decoder.leave.weight, std=0.05)
    before = {key: value.clone() for key, value in generator.tensors().items()}

    def fields(steps: int, seed: int = 0):
        generator.config = replace(TINY, fit=steps)
        return generator.adapt(*scout_of(store), seed).field

    plain, fitted, again, other = fields(0), fields(3), fields(3), fields(3, 1)
    assert torch.equal(fitted, again) and not torch.equal(fitted, plain)
    assert not torch.equal(fitted, other), "the seed draws the frames of a step"
    assert all(torch.equal(value, before[key]) for key, value in generator.tensors().items())
    assert all(weight.grad is None for weight in generator.net("painter").parameters())


def test_fitting_brings_frames_that_it_does_not_see_nearer(store, fitted):
    """A field fitted to most frames of a scout paints the rest better than that of the prior."""
    generator = own(fitted)
    torch.manual_seed(0)
    torch.nn.init.normal_(generator.net("painter").painter.decoder.leave.weight, std=0.05)
    images, parameters = scout_of(store)
    held = torch.zeros(FRAMES, dtype=torch.bool)
    held[4::16] = True

    def error(steps: int) -> float:
        generator.config = replace(TINY, fit=steps, fit_rate=0.1)
        drawn = generator.adapt(images[~held], parameters[~held], 0).generate(parameters[held], 0)
        return float((drawn.float() - images[held].float()).abs().mean())

    assert error(30) < 0.98 * error(0)


def test_few_frames_are_enough(store, fitted):
    generator = own(fitted)
    images, parameters = scout_of(store)
    least = generator.scout
    met = generator.adapt(images[:least], parameters[:least], 0)
    assert met.generate(parameters[-2:], 0).shape == (2, 128, 128)


def test_a_frame_is_painted_without_itself_and_its_neighbours(store, fitted, monkeypatch):
    generator = own(fitted)
    images, parameters = scout_of(store)
    places, asked = parameters_to_pose(parameters).position, []
    painter = generator.net("painter")
    paint = painter.forward

    def looked(scouts, owner, pose, field, home):
        kept = [place for place in range(FRAMES)
                if (scouts.poses.position[0] == places[place]).all(1).any()]  # fmt: skip
        for each in pose.position:
            row = int((places == each).all(1).nonzero()[0])
            assert not {row - 1, row, row + 1} & set(kept)
            asked.append(row)
        assert len(kept) >= FRAMES - 3 * len(pose.position)
        return paint(scouts, owner, pose, field, home)

    monkeypatch.setattr(painter, "forward", looked)
    generator.config = replace(TINY, fit=3)
    generator.adapt(images, parameters, 0)
    assert len(asked) == 24 and len(set(asked)) > 8
