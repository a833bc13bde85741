"""The contract for each of our generators, and what each does beyond it."""

import importlib
import math
from pathlib import Path

import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import geodesic, parameters_to_pose
from racines_models.generators.mean_image import MeanImage
from racines_models.generators.nearest_pose import NearestPose, NearestPoseConfig
from racines_models.generators.vae_gan import VaeGan, VaeGanConfig
from racines_models.protocol import Run
from racines_models.registry import generator_names
from racines_models.testing import GeneratorContract
from racines_models.training.objective import Training
from tests.conftest import ROOT
from tests.models.conftest import FakeStore

TINY = VaeGanConfig(
    width=4,
    encoder_width=2,
    discriminator_width=2,
    latent=8,
    embedding=8,
    learning_rate=0.01,
    training=Training(images=320, batch_size=16, precision="fp32"),
)


class TestMeanImage(GeneratorContract):
    generator_class = MeanImage
    exportable = True

    def test_it_is_the_mean_of_train(self, store, tmp_path):
        image = self.fitted(store, tmp_path).generate(self.parameters(store, 1), 0)[0]
        train = store.images[store.split_indices("train")].double()
        assert (image.double() - train.mean(0)).abs().max() <= 0.5


class TestNearestPose(GeneratorContract):
    generator_class = NearestPose

    def test_a_training_pose_gives_its_own_image(self, store, tmp_path):
        rows = torch.tensor([3, 200, 77])
        images = self.fitted(store, tmp_path).generate(store.parameters[rows], 0)
        assert torch.equal(images, store.images[rows])

    def test_distance_is_the_documented_one(self, store, tmp_path):
        generator = self.fitted(store, tmp_path)
        poses = self.parameters(store)
        index, distance = generator.nearest(poses)
        here, there = parameters_to_pose(poses), parameters_to_pose(store.parameters)
        shift = (here.position[:, None] - there.position[None]).norm(dim=-1)
        angle = geodesic(here.rotation[:, None], there.rotation[None])
        wanted = (shift**2 + (0.07 * 2 * torch.sin(angle / 2)) ** 2).sqrt()
        wanted = wanted[:, store.split_indices("train")]
        assert torch.equal(index, wanted.argmin(1))
        torch.testing.assert_close(distance, wanted.amin(1), atol=1e-6, rtol=1e-4)

    def test_rotation_wraps(self, store, tmp_path):
        """Either side of rotation_x = ±π is one place."""
        generator = self.fitted(store, tmp_path)
        pose = store.parameters[5:6].clone()
        pose[0, 9] += 2 * math.pi if pose[0, 9] < 0 else -2 * math.pi
        assert torch.equal(generator.generate(pose, 0), store.images[5:6])

    def test_of_equal_poses_the_first_wins(self, tmp_path):
        store = FakeStore()
        store.parameters[50] = store.parameters[150] = store.parameters[100]
        generator = self.fitted(store, tmp_path)
        images = generator.generate(store.parameters[[150, 100]], 0)
        assert torch.equal(images, store.images[[50, 50]])

    def test_frames_limits_the_memory(self, store, tmp_path):
        generator = NearestPose(NearestPoseConfig(frames=10))
        generator.fit(store, Run(tmp_path, progress=False))
        assert len(generator.tensors()["images"]) == 10

    def test_weight_decides_between_a_shift_and_a_turn(self, tmp_path):
        store = FakeStore()
        query = store.parameters[0].clone()
        shifted, turned = query.clone(), query.clone()
        shifted[6] += 0.01
        turned[11] += 0.2
        store.parameters[:240] = query + torch.tensor([0.0] * 6 + [0.5] * 6)
        store.parameters[20], store.parameters[30] = shifted, turned
        for weight, winner in ((0.01, 30), (1.0, 20)):
            generator = NearestPose(NearestPoseConfig(metres_per_radian=weight))
            generator.fit(store, Run(tmp_path, progress=False))
            assert int(generator.nearest(query[None])[0]) == winner


class TestVaeGan(GeneratorContract):
    generator_class = VaeGan  # its exported file: tests/models/exchange/test_onnx.py
    config = TINY

    def test_posterior_and_prior_noise_differ_by_sample(self, store, tmp_path):
        generator = self.fitted(store, tmp_path)
        same_pose = self.parameters(store, 1).repeat(6, 1)
        images = generator.generate(same_pose, 1)
        assert len({image.numpy().tobytes() for image in images}) == 6

    def test_discriminator_stays_behind(self, store, tmp_path):
        names = set(self.fitted(store, tmp_path).tensors())
        assert {name.split(".")[0] for name in names} == {"conditioning", "encoder", "decoder"}

    def test_damaged_weights_are_refused(self, store, tmp_path):
        self.fitted(store, tmp_path)
        path = tmp_path / "model.safetensors"
        path.write_bytes(path.read_bytes()[:-100])
        with pytest.raises(RacinesError, match="model.safetensors: cannot be read"):
            VaeGan.load(tmp_path)

    def test_each_loss_counts(self, store, tmp_path):
        """Switching a loss off changes the weights: none is dead code."""
        files = []
        weights = ("kl_weight", "adversarial_weight", "reconstruction_weight")
        short = {"training": Training(images=32, batch_size=16, precision="fp32")}
        for name in ("none", *weights):
            config = VaeGanConfig(**(vars(TINY) | short | ({name: 0.0} if name in weights else {})))
            VaeGan(config).fit(store, Run(tmp_path / name, progress=False))
            files.append((tmp_path / name / "model.safetensors").read_bytes())
        assert len(set(files)) == 4


@pytest.mark.thorough
@pytest.mark.slow
def test_vae_gan_learns_to_follow_the_pose(store, tmp_path):
    """In 200 small steps it beats the mean image, and only at the right pose."""
    training = Training(images=1600, batch_size=8, precision="fp32", ema=0.98)
    config = VaeGanConfig(
        width=4,
        encoder_width=2,
        discriminator_width=2,
        learning_rate=0.01,
        training=training,
    )
    generator = VaeGan(config)
    metrics = generator.fit(store, Run(tmp_path / "vae", progress=False))
    mean = MeanImage().fit(store, Run(tmp_path / "mean", progress=False))
    assert metrics["validation"]["psnr"] > mean["validation"]["psnr"] + 1.0
    frames = store.split_indices("test")
    drawn = generator.generate(store.parameters[frames], 0).double()
    truth = store.images[frames].double()
    assert (drawn - truth).abs().mean() < 0.8 * (drawn.roll(1, 0) - truth).abs().mean()


def test_euler_ablation_trains(store, tmp_path):
    config = VaeGanConfig(**(vars(TINY) | {"conditioning": "euler"}))
    VaeGan(config).fit(store, Run(tmp_path, progress=False))
    assert VaeGan.load(tmp_path).tensors()["conditioning.mean"].shape == (12,)


def test_every_registered_generator_has_a_contract_test():
    """In any file of these folders: a test class that inherits the contract."""
    for path in Path(__file__).parents[1].rglob("test_*.py"):
        importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
    tested, waiting = set(), GeneratorContract.__subclasses__()
    while waiting:
        cls = waiting.pop()
        waiting += cls.__subclasses__()
        tested |= {vars(cls)["generator_class"].name} if "generator_class" in vars(cls) else set()
    assert set(generator_names()) <= tested


def test_unfitted_generator_says_so(store):
    with pytest.raises(RacinesError, match="mean-image is not fitted"):
        MeanImage().generate(store.parameters[:1], 0)


def test_empty_train_split_is_refused(tmp_path):
    with pytest.raises(RacinesError, match="no train frames"):
        MeanImage().fit(FakeStore(train=0), Run(tmp_path))


@pytest.mark.parametrize(
    "change",
    [{"width": 0}, {"latent": 0}, {"kl_weight": -1.0}, {"learning_rate": 0.0}],
    ids=lambda change: next(iter(change)),
)
def test_impossible_settings_are_refused(change):
    with pytest.raises(RacinesError, match="vae-gan"):
        VaeGanConfig(**change)
