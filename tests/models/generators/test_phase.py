"""Generators on data that know the phase of the beat: the contract, and what a phase changes."""

import dataclasses
from typing import ClassVar

import pytest
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.imaging import conditions_for
from racines_models.generators.cgan import Cgan, CganConfig
from racines_models.generators.flow import Flow, FlowConfig
from racines_models.generators.mean_image import MeanImage
from racines_models.generators.nearest_pose import NearestPose, NearestPoseConfig
from racines_models.generators.scene_field import SceneField, SceneFieldConfig
from racines_models.generators.vae_gan import VaeGan, VaeGanConfig
from racines_models.networks.layers import Conditioning
from racines_models.networks.scene_field.probe import ProbeGeometry
from racines_models.protocol import Run
from racines_models.provenance import dataset_card
from racines_models.testing import GeneratorContract
from racines_models.training.objective import Training
from tests.models.conftest import FakeStore

PHASES = 4
FEW = Training(images=64, batch_size=16, precision="fp32")
GANS = {"width": 4, "discriminator_width": 2, "latent": 8, "embedding": 8, "training": FEW}
FIELD = SceneFieldConfig(
    probe=ProbeGeometry(beams=16, samples=24), voxel=0.006, coarse_voxel=0.012, coverage=0.9,
    training=Training(images=32, batch_size=16, precision="fp32", ema=0.0),
)  # fmt: skip


class BeatingStore(FakeStore):
    """Frames whose left half brightens with the beat; poses have no forces."""

    def __init__(self, seed: int = 0, unit: float = 1.0):
        super().__init__(seed)
        beat = torch.arange(len(self.images)) % PHASES / PHASES
        self.phases = torch.stack([beat, torch.full_like(beat, torch.nan)], 1).double()
        self.turns = torch.zeros(len(beat), 2, dtype=torch.float64)
        self.parameters[:, :6] = torch.nan
        self.parameters[:, 6:9] *= unit
        shade = (0.6 + 0.4 * torch.cos(2 * torch.pi * beat))[:, None, None]
        half = self.images[:, :, :64].float() * shade
        self.images[:, :, :64] = half.round().to(torch.uint8)
        self._words = self.images.view(len(self.images), -1).view(torch.int64)


@pytest.fixture(scope="module")
def store() -> BeatingStore:
    return BeatingStore()


class Beats(GeneratorContract):
    """What holds of every generator that is fitted on phases, beside the contract."""

    follows: ClassVar[bool] = True
    """Within the budget of a test, the drawn beat is that of the data."""

    def test_the_phase_changes_the_image(self, store, tmp_path):
        generator = self.fitted(store, tmp_path)
        poses = self.parameters(store)
        later = poses.clone()
        later[:, 12] = (later[:, 12] + 0.5) % 1.0
        first, other = (generator.generate(x, 5) for x in (poses, later))
        assert not torch.equal(first, other)

    def test_the_end_of_a_beat_is_its_start(self, store, tmp_path):
        generator = self.fitted(store, tmp_path)
        poses = self.parameters(store)
        poses[:, 12] = 0.0
        whole = poses.clone()
        whole[:, 12] = 1.0 - 1e-6
        apart = generator.generate(poses, 5).int() - generator.generate(whole, 5).int()
        assert int(apart.abs().max()) <= 1

    def test_a_phase_is_needed(self, store, tmp_path):
        generator = self.fitted(store, tmp_path)
        with pytest.raises(RacinesError, match=r"at a phase of its beat: give \(B, 13\)"):
            generator.generate(self.parameters(store)[:, :12], 0)
        broken = self.parameters(store)
        broken[1, 12] = torch.nan
        with pytest.raises(RacinesError, match="cardiac_phase of row 1 is not finite"):
            generator.generate(broken, 0)

    def test_the_brightness_follows_the_beat(self, store, tmp_path):
        if not self.follows:
            return
        generator = self.fitted(store, tmp_path)
        poses = self.parameters(store)
        drawn = []
        for phase in range(PHASES):
            poses[:, 12] = phase / PHASES
            drawn.append(float(generator.generate(poses, 5)[:, :, :64].float().mean()))
        assert drawn[0] > max(drawn[1], drawn[3]) > drawn[2], drawn

    def test_the_card_says_that_phases_are_known(self, store, tmp_path):
        assert self.fitted(store, tmp_path).card.data["phase"] is True


class TestMeanImageOfABeat(Beats):
    generator_class = MeanImage
    exportable = True

    def test_it_is_the_mean_at_each_phase(self, store, tmp_path):
        generator = self.fitted(store, tmp_path)
        train = store.split_indices("train")
        rows = train[store.phases[train, 0] == 0.25]
        poses = self.parameters(store, 1)
        poses[:, 12] = 0.25
        wanted = store.images[rows].double().mean(0)
        assert (generator.generate(poses, 0)[0].double() - wanted).abs().max() <= 0.5


class TestNearestPoseOfABeat(Beats):
    generator_class = NearestPose
    config = NearestPoseConfig(metres_per_beat=10.0)
    follows = False  # another place's image may be darker

    def test_the_nearest_has_the_phase_and_a_training_frame_its_own_image(self, store, tmp_path):
        generator = self.fitted(store, tmp_path)
        train = store.split_indices("train")
        found = train[generator.nearest(self.parameters(store))[0]]
        tested = store.split_indices("test")[: len(found)]
        assert torch.equal(store.phases[found, 0], store.phases[tested, 0])
        rows = train[[5, 90]]
        assert torch.equal(generator.generate(store.conditions(rows), 0), store.images[rows])


class TestVaeGanOfABeat(Beats):
    generator_class = VaeGan
    config = VaeGanConfig(**GANS, encoder_width=2, learning_rate=0.01)
    exportable = True
    follows = False


class TestCganOfABeat(Beats):
    generator_class = Cgan
    config = CganConfig(**GANS | {"training": dataclasses.replace(FEW, images=320)})
    exportable = True
    follows = False

    @pytest.mark.thorough
    def test_exported_file_draws_the_same(self, store, tmp_path):
        super().test_exported_file_draws_the_same(store, tmp_path)


class TestFlowOfABeat(Beats):
    generator_class = Flow
    config = FlowConfig(width=8, octaves=2, training=FEW)
    exportable = True
    follows = False

    @pytest.mark.thorough
    def test_exported_file_draws_the_same(self, store, tmp_path):
        super().test_exported_file_draws_the_same(store, tmp_path)


class TestSceneFieldOfABeat(Beats):
    generator_class = SceneField
    config = FIELD
    exportable = True
    follows = False

    @pytest.mark.thorough
    def test_exported_file_draws_the_same(self, store, tmp_path):
        super().test_exported_file_draws_the_same(store, tmp_path)


def test_a_field_without_waves_draws_a_still_scene(store, tmp_path):
    generator = SceneField(dataclasses.replace(FIELD, harmonics=0))
    generator.fit(store, Run(tmp_path, device="cpu", progress=False))
    assert generator.tensors()["fine.codes"].shape[-1] == FIELD.channels
    with_waves = SceneField(dataclasses.replace(FIELD, harmonics=1))
    with_waves.fit(store, Run(tmp_path, device="cpu", progress=False))
    assert with_waves.tensors()["fine.codes"].shape[-1] == 3 * FIELD.channels


@pytest.mark.thorough
def test_a_field_learns_the_beat(store, tmp_path):
    loop = dataclasses.replace(FIELD.training, images=960)
    generator = SceneField(dataclasses.replace(FIELD, training=loop))
    generator.fit(store, Run(tmp_path, device="cpu", progress=False))
    poses = store.take(store.split_indices("test")).parameters
    drawn = []
    for phase in range(PHASES):
        poses[:, 12] = phase / PHASES
        drawn.append(float(generator.generate(poses, 0)[:, :, :64].float().mean()))
    assert drawn[0] > 1.1 * max(drawn[1], drawn[3]) and min(drawn[1], drawn[3]) > 1.1 * drawn[2]


# --- forces that are absent, phases that nobody asks for, positions without a scale ---------------


def test_absent_forces_condition_nothing():
    store = BeatingStore()
    conditioning = Conditioning(phased=True).fit(store.conditions(store.split_indices("train")))
    rows = store.conditions(store.split_indices("test"))
    encoded = conditioning(rows)
    assert encoded.shape == (len(rows), 17) and bool((encoded[:, 9:15] == 0).all())
    with_force = rows.clone()
    with_force[:, :6] = 0.0
    assert torch.equal(conditioning(with_force), encoded)
    raw = Conditioning("euler", phased=True).fit(store.conditions(store.split_indices("train")))
    assert raw(rows).shape == (len(rows), 14) and bool(raw(rows).isfinite().all())


def test_a_generator_without_phases_ignores_them(tmp_path):
    still = FakeStore()
    generator = NearestPose()
    generator.fit(still, Run(tmp_path, device="cpu", progress=False))
    poses = still.take(still.split_indices("test")).parameters
    with_phase = torch.cat([poses, torch.full((len(poses), 1), 0.3)], 1)
    assert torch.equal(generator.generate(poses, 0), generator.generate(with_phase, 0))
    assert "phase" not in dataset_card(still) and "scale" not in dataset_card(still)
    assert conditions_for(with_phase, False, "x").shape == poses.shape
    with pytest.raises(RacinesError, match=r"shape \(16, 14\): give \(B, 12\)"):
        generator.generate(torch.cat([with_phase, with_phase[:, :1]], 1), 0)


def alike(one: Tensor, other: Tensor) -> float:
    return float((one.float() - other.float()).abs().mean())


@pytest.mark.parametrize(
    "generator",
    [NearestPose(), Flow(FlowConfig(width=8, octaves=2, training=FEW)), SceneField(FIELD)],
    ids=["nearest-pose", "flow", "scene-field"],
)
def test_pixels_of_an_unknown_scale_stand_for_millimetres(generator, tmp_path):
    """What is set in metres fits positions in pixels as well: one picture, but for rounding."""
    drawn = []
    for unit in (1.0, 1e3):
        store = BeatingStore(unit=unit)
        if unit > 1:
            store.manifest = store.manifest | {"scale": "unknown"}
        fitted = type(generator)(generator.config)
        fitted.fit(store, Run(tmp_path / f"{unit}", device="cpu", progress=False))
        assert fitted.metres == 1 / unit
        loaded = type(generator).load(tmp_path / f"{unit}")
        drawn.append(loaded.generate(store.take(store.split_indices("test")).parameters, 0))
    assert alike(*drawn) < 2.0
