"""The flow: its contract, its steps, and what its network sees."""

import dataclasses

import pytest
import torch
from torch import nn

from racines_data.errors import RacinesError
from racines_data.geometry import parameters_to_pose
from racines_models.exchange.onnx.generator import export_generator
from racines_models.generators.flow import Flow, FlowConfig, follow
from racines_models.networks.unet import GRID, SPREAD, Place, scales
from racines_models.protocol import Run
from racines_models.registry import open_generator
from racines_models.testing import GeneratorContract
from racines_models.training.objective import Training

TINY = FlowConfig(
    width=8,
    octaves=3,
    learning_rate=0.01,
    steps=2,
    training=Training(images=64, batch_size=16, precision="fp32", ema=0.5),
)


class TestFlow(GeneratorContract):
    generator_class = Flow
    config = TINY

    def test_steps_and_solver_are_settings_of_drawing(self, store, tmp_path):
        generator, poses = self.fitted(store, tmp_path), self.parameters(store, 3)
        drawn = []
        for steps, solver in ((1, "euler"), (2, "euler"), (2, "heun"), (4, "heun")):
            other = generator.with_steps(steps, solver)
            assert (other.config.steps, other.config.solver) == (steps, solver)
            drawn.append(other.generate(poses, 0).numpy().tobytes())
        assert generator.config == TINY
        assert len(set(drawn)) == 4

    @pytest.mark.thorough
    @pytest.mark.parametrize("steps", [1, 2])
    def test_exported_file_draws_the_same(self, store, tmp_path, steps):
        pytest.importorskip("onnxscript")
        generator, poses = self.fitted(store, tmp_path), self.parameters(store, 5)
        generator = generator.with_steps(steps, "euler")
        export_generator(generator, tmp_path / "flow.onnx")
        drawn = open_generator(str(tmp_path / "flow.onnx")).generate(poses, 3).int()
        assert (drawn - generator.generate(poses, 3).int()).abs().max() <= 1


def test_preconditioned_flow_trains_and_differs(store, tmp_path):
    config = dataclasses.replace(TINY, preconditioned=True)
    generator, plain = Flow(config), Flow(TINY)
    for each, name in ((generator, "a"), (plain, "b")):
        each.fit(store, Run(tmp_path / name, device="cpu", progress=False))
    poses = store.parameters[:3]
    drawn = Flow.load(tmp_path / "a").generate(poses, 0)
    assert torch.equal(drawn, generator.generate(poses, 0))
    assert not torch.equal(drawn, plain.generate(poses, 0))


class Straight(nn.Module):
    """Foresees one image from anywhere; counts how often it is asked, and when."""

    def __init__(self, end):
        super().__init__()
        self.end, self.times = end, []

    def forward(self, x, time, parameters):
        self.times.append(float(time[0]))
        return self.end.expand_as(x)


@pytest.mark.parametrize(
    ("steps", "solver", "spacing", "times"),
    [
        (1, "euler", 1.0, [0.0]),
        (1, "heun", 2.0, [0.0]),
        (4, "euler", 2.0, [0.0, 0.4375, 0.75, 0.9375]),
        (2, "heun", 1.0, [0.0, 0.5, 0.5]),
    ],
)
def test_straight_flow_ends_where_it_was_foreseen(steps, solver, spacing, times):
    end, noise = torch.rand(1, 16, GRID, GRID), torch.randn(3, 16, GRID, GRID)
    net = Straight(end)
    drawn = follow(net, noise, torch.zeros(3, 12), steps, solver, spacing)
    torch.testing.assert_close(drawn, end.expand_as(drawn))
    assert net.times == times


def test_scales_are_the_best_linear_guess():
    """Of an image of deviation SPREAD seen through noise: keep it, and what deviation is left."""
    generator = torch.Generator().manual_seed(0)
    image, noise = SPREAD * torch.randn(10**6, generator=generator), torch.randn(10**6)
    for time in (0.0, 0.5, 0.9):
        seen = (1 - time) * noise + time * image
        keep, change, deviation = scales(torch.tensor([time]))
        assert float(deviation) == pytest.approx(float(seen.std()), rel=0.01)
        best = float((seen * image).mean() / seen.square().mean())
        assert float(keep) == pytest.approx(best, abs=0.01)
        assert float(change) == pytest.approx(float((image - keep * seen).std()), rel=0.01)


def test_heun_is_of_second_order():
    """The slope is -x / 2, so the flow ends at exp(-1 / 2) times its start."""

    class Decay(nn.Module):
        def forward(self, x, time, parameters):
            return x - (1.0 - time.view(-1, 1, 1, 1)) * 0.5 * x

    start = torch.ones(1, 16, GRID, GRID)
    exact = torch.exp(torch.tensor(-0.5))
    euler, heun = (
        float((follow(Decay(), start, torch.zeros(1, 12), 4, solver) - exact).abs().max())
        for solver in ("euler", "heun")
    )
    assert heun < 0.5 * euler < 0.02


def test_place_of_the_cells_is_that_of_the_pose(store):
    """The cell in the middle of the first row lies below the probe's tip, along the beam."""
    place = Place(extent=0.2, octaves=1)
    parameters = store.parameters[:4]
    features = place(parameters, torch.zeros(3))
    pose = parameters_to_pose(parameters)
    lateral, axial = place.cells[:, 5, 20]
    point = pose.position + pose.rotation[..., 0] * lateral + pose.rotation[..., 2] * axial
    phase = point * (2 * torch.pi / 0.32)
    wanted = torch.cat([phase.sin(), phase.cos()], -1)
    torch.testing.assert_close(features[:, :, 5, 20], wanted, atol=1e-5, rtol=1e-4)
    assert float(axial) == pytest.approx(0.2 * 5.5 / GRID)


def test_time_is_zero_for_the_asked_share(store, tmp_path):
    seen = []

    class Spy(Flow):
        def updates(self, nets, batch):
            def unet(x, time, parameters):
                seen.append(time)
                return nets["unet"](x, time, parameters)

            yield from super().updates({"unet": unet}, batch)

    Spy(TINY).fit(store, Run(tmp_path, device="cpu", progress=False))
    times = torch.cat(seen)
    assert 0.3 < float((times == 0).float().mean()) < 0.7
    assert float(times.max()) < 1.0 and len(times.unique()) > 16


@pytest.mark.slow
@pytest.mark.thorough
def test_flow_learns_to_follow_the_pose(store, tmp_path):
    training = Training(images=2000, batch_size=8, precision="fp32", ema=0.9, schedule="cosine")
    config = FlowConfig(width=8, octaves=2, learning_rate=0.005, pure_noise=1.0, training=training)
    generator = Flow(config)
    generator.fit(store, Run(tmp_path, device="cpu", progress=False))
    frames = store.split_indices("test")
    drawn = generator.generate(store.parameters[frames], 0).double()
    truth = store.images[frames].double()
    assert (drawn - truth).abs().mean() < 0.8 * (drawn.roll(1, 0) - truth).abs().mean()


@pytest.mark.parametrize(
    "change",
    [
        {"width": 12},
        {"octaves": 0},
        {"extent": 0.0},
        {"learning_rate": 0.0},
        {"pure_noise": 1.5},
        {"steps": 5},
        {"spacing": 0.0},
        {"solver": "magic"},
    ],
    ids=lambda change: next(iter(change)),
)
def test_impossible_settings_are_refused(change):
    with pytest.raises(RacinesError, match="flow"):
        FlowConfig(**change)
