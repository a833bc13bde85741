"""The scene field: its contract, its field, its probe, and what it finds out by itself."""

import dataclasses

import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, parameters_to_pose
from racines_models.exchange.onnx.generator import export_generator
from racines_models.generators.scene_field import SceneField, SceneFieldConfig
from racines_models.networks.scene_field.echo import similarity
from racines_models.networks.scene_field.field import VoxelField, lay_out
from racines_models.networks.scene_field.probe import Probe, ProbeGeometry
from racines_models.protocol import Run
from racines_models.registry import open_generator
from racines_models.scores.metrics import ssim
from racines_models.testing import GeneratorContract
from racines_models.training.objective import Training
from racines_models.weights import publish
from tests.models.conftest import FakeStore, random_parameters

LOOP = Training(images=32, batch_size=16, precision="fp32", ema=0.0)
TINY = SceneFieldConfig(
    probe=ProbeGeometry(beams=16, samples=24),
    voxel=0.006,
    coarse_voxel=0.012,
    coverage=0.9,
    training=LOOP,
)


class TestSceneField(GeneratorContract):
    generator_class = SceneField
    config = TINY


def test_killed_and_resumed_ends_in_the_same_bytes(store, tmp_path, monkeypatch):
    loop = dataclasses.replace(LOOP, images=64, checkpoint_every=16, schedule="cosine")
    config = dataclasses.replace(TINY, training=loop)
    whole, broken = (Run(tmp_path / name, device="cpu", progress=False) for name in "ab")
    SceneField(config).fit(store, whole)
    steps, updates = iter(range(2)), SceneField.updates

    def interrupted(self, nets, batch):
        if next(steps, None) is None:
            raise KeyboardInterrupt
        return updates(self, nets, batch)

    with monkeypatch.context() as patched:
        patched.setattr(SceneField, "updates", interrupted)
        with pytest.raises(KeyboardInterrupt):
            SceneField(config).fit(store, broken)
    SceneField(config).fit(store, dataclasses.replace(broken, resume=True))
    a, b = (run.folder / "model.safetensors" for run in (whole, broken))
    assert a.read_bytes() == b.read_bytes()


def test_published_weights_draw_the_same_within_a_gray_level(store, tmp_path):
    generator = SceneField(TINY)
    generator.fit(store, Run(tmp_path / "run", device="cpu", progress=False))
    publish(tmp_path / "run", tmp_path / "out")
    sizes = [(tmp_path / each / "model.safetensors").stat().st_size for each in ("run", "out")]
    assert sizes[1] <= sizes[0] < 2 * sum(x.numel() for x in generator.tensors().values())
    drawn = SceneField.load(tmp_path / "out").generate(store.parameters[:4], 0).int()
    assert int((drawn - generator.generate(store.parameters[:4], 0).int()).abs().max()) <= 1


def test_a_plane_is_drawn_too(store, tmp_path):
    probe = dataclasses.replace(TINY.probe, kind="plane")
    generator = SceneField(dataclasses.replace(TINY, probe=probe))
    generator.fit(store, Run(tmp_path, device="cpu", progress=False))
    images = generator.generate(store.parameters[:3], 0)
    assert int(images[:, -1, 0].min()) > 0, "a plane has no dark corners"


@pytest.mark.parametrize(
    "wrong",
    [{"kind": "cone"}, {"beams": 15}, {"half_angle": 2.0}, {"depth": 0.0}],
)
def test_impossible_probe_is_refused(wrong):
    with pytest.raises(RacinesError, match=r"scene-field\.probe"):
        ProbeGeometry(**wrong)


def field_of_a_ramp(voxel: float = 2.0) -> tuple[VoxelField, torch.Tensor]:
    """A field whose one number is a linear function of the place, and points inside it."""
    points = torch.rand(3000, 3, generator=torch.Generator().manual_seed(0)) * 50.0
    field = VoxelField(lay_out(points, voxel, 1.0), voxel, 1, 0.0)
    shape = torch.tensor(field.table.shape) * 8
    voxels = torch.cartesian_prod(*(torch.arange(int(n)) for n in shape))
    place = field.origin + voxels * voxel
    brick, inner = voxels // 8, voxels % 8
    row = field.table[tuple(brick.T)].long() + inner @ torch.tensor([64, 8, 1])
    own = row >= 512  # the first brick is shared
    field.values.data[row[own], 0] = (place[own] @ torch.tensor([1.0, -2.0, 0.5])).float()
    return field, points.T.contiguous()


def test_field_is_linear_between_voxels_also_across_bricks():
    field, points = field_of_a_ramp()
    inside = ((points > 8.0) & (points < 42.0)).all(0)
    points = points[:, inside]
    wanted = torch.tensor([1.0, -2.0, 0.5]) @ points
    torch.testing.assert_close(field(points)[:, 0], wanted, atol=1e-3, rtol=1e-4)


def test_points_get_the_slope_of_the_field():
    field, points = field_of_a_ramp()
    inside = ((points > 8.0) & (points < 42.0)).all(0)
    points = points[:, inside][:, :7].requires_grad_()
    field(points, live=7).sum().backward()
    slope = torch.tensor([1.0, -2.0, 0.5]).unsqueeze(1).expand(3, 7)
    torch.testing.assert_close(points.grad, slope, atol=1e-3, rtol=1e-3)


def test_picked_gradient_is_right_on_average():
    field, points = field_of_a_ramp()
    points = points[:, :1].expand(3, 20_000).contiguous()
    picks = torch.rand(20_000, generator=torch.Generator().manual_seed(1))
    grads = []
    for each in (None, picks):
        field.values.grad = None
        field(points, each).sum().backward()
        assert field.values.grad is not None
        grads.append(field.values.grad / 20_000)
    torch.testing.assert_close(*grads, atol=0.02, rtol=0.0)


def test_coverage_keeps_the_most_visited_bricks():
    crowd, lone = torch.rand(990, 3) * 15.0, torch.rand(10, 3) * 15.0 + 160.0
    everything = lay_out(torch.cat([crowd, lone]), 2.0, 1.0)
    most = lay_out(torch.cat([crowd, lone]), 2.0, 0.95)
    assert most.rows < everything.rows
    assert int((most.table > 0).sum()) * 512 + 512 == most.rows


def test_eight_bits_hold_the_field():
    field, points = field_of_a_ramp()
    before = field(points).detach().clone()
    field.quantise()
    other = VoxelField(lay_out(points.T, 2.0, 1.0), 2.0, 1, 1.0)
    other.unpack(field.packed())
    assert torch.equal(other(points), field(points))
    change = (field(points).detach() - before).abs().max()
    assert float(change) < 1.0 < float(before.abs().max()) / 50


def test_coarse_points_lie_between_fine_ones():
    pose = parameters_to_pose(random_parameters(2, 0))
    probe = Probe(ProbeGeometry(face=0.02, shift=(0.001, 0.0, -0.002), turn=(0.1, 0.0, 0.2)))
    fine, coarse = probe.points(pose), probe.points(pose, coarse=True)
    wanted = fine.unflatten(3, (-1, 2)).unflatten(2, (-1, 2)).mean((3, 5))
    torch.testing.assert_close(coarse, wanted, atol=1e-3, rtol=0.0)


def test_convex_beams_start_on_the_face():
    probe = Probe(ProbeGeometry(face=0.05, half_angle=0.5))
    middle = probe.axial[47:49, 0].mean().item()
    assert 0.0 < middle < 1.0, "the face's centre lies at the recorded pose"
    assert probe.axial[0, 0] < middle - 5.0, "its edges lie behind"
    assert probe.mask[0, 64] == 1.0 and probe.mask[127, 0] == 0.0


def test_similarity_is_that_of_the_score():
    truth = random_pictures(3)
    drawn = truth.roll(2, 2)
    score = ssim(drawn, truth).mean()
    ours = similarity(drawn / 255.0, truth / 255.0)
    assert float(ours) == pytest.approx(float(score), abs=1e-4)


def random_pictures(count: int) -> torch.Tensor:
    return FakeStore(seed=5, train=count).images[:count]


class RigidStore(FakeStore):
    """Pictures of one still scene of soft balls, cut by an image plane that sits askew."""

    shift = (0.004, -0.003, 0.003)
    turn = (0.0, 0.0, 0.12)

    def __init__(self, train: int = 240):
        super().__init__(train=train)
        self.parameters[:, 11] *= 4.0  # a shift shows where the probe is turned about its beam
        generator = torch.Generator().manual_seed(2)
        spread = torch.tensor([70.0, 70.0, 60.0])
        centre = torch.tensor([490.0, 0.0, 20.0])
        self.balls = centre + spread * (2 * torch.rand(40, 3, generator=generator) - 1)
        pose = parameters_to_pose(self.parameters)
        probe = Probe(ProbeGeometry("plane", 64, 64, depth=0.1, shift=self.shift, turn=self.turn))
        with torch.no_grad():
            drawn = [
                self._slice(probe, Pose(*each))
                for each in zip(*(x.split(32) for x in pose), strict=True)
            ]
        self.images = torch.cat(drawn)

    def _slice(self, probe: Probe, pose: Pose) -> torch.Tensor:
        points = probe.points(pose).movedim(0, -1)
        near = torch.cdist(points.reshape(1, -1, 3), self.balls.unsqueeze(0)).min(-1).values
        gray = 0.1 + 0.8 * torch.exp(-0.5 * (near / 7.0) ** 2).view(points.shape[:-1])
        return probe.image(gray).mul(255.0).round().to(torch.uint8)


@pytest.mark.thorough
def test_wrong_calibration_is_found_out(tmp_path):
    store = RigidStore()
    loop = dataclasses.replace(LOOP, images=800, batch_size=8, schedule="cosine")
    config = SceneFieldConfig(
        probe=ProbeGeometry("plane", 32, 32, depth=0.1),
        voxel=0.005,
        coarse_voxel=0.005,
        field_rate=0.02,
        coarse_rate=0.05,
        calibration_rate=0.3,
        offset_rate=0.0,
        training=loop,
    )
    generator = SceneField(config)
    found = generator.fit(store, Run(tmp_path, device="cpu", progress=False))["calibration"]
    # The third, along the beam, shows only where the probe leans, which it hardly does here.
    for axis in (0, 1):
        assert found["shift_m"][axis] == pytest.approx(store.shift[axis], abs=0.0015)
    assert found["turn_rad"][2] == pytest.approx(store.turn[2], abs=0.04)


@pytest.mark.thorough
def test_an_onnx_file_draws_what_the_class_draws(store, tmp_path):
    """Within a gray level, but for points that fall on the other side of a voxel's edge."""
    generator = SceneField(TINY)
    generator.fit(store, Run(tmp_path, device="cpu", progress=False))
    made = export_generator(generator, tmp_path / "field.onnx")
    assert made["noise"] == 0
    poses = store.parameters[:12]
    opened = open_generator(str(tmp_path / "field.onnx"))
    apart = (opened.generate(poses, 0).int() - generator.generate(poses, 0).int()).abs()
    assert float(apart.float().mean()) < 0.01 and int((apart > 1).sum()) < 1e-3 * apart.numel()
