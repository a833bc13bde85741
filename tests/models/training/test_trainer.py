"""The training loop: budget, order of updates, curves, samples, averaging, precision."""

import dataclasses
import json
import math

import pytest
import torch
from PIL import Image
from torch import nn
from torch.optim import SGD

from racines_data.errors import RacinesError
from racines_models.generators.base import BaseGenerator
from racines_models.protocol import Run
from racines_models.training.checkpoint import Checkpoint
from racines_models.training.log import Guard
from racines_models.training.objective import Feed, Training, Update, rate_factor
from racines_models.training.trainer import Average, resolve_precision, train


@dataclasses.dataclass(frozen=True)
class ToyConfig:
    training: Training = dataclasses.field(
        default_factory=lambda: Training(images=40, batch_size=4, ema=0.0, precision="fp32")
    )


class Toy(BaseGenerator[ToyConfig]):
    """Two scalars, each with its optimizer; the second loss sees what the first step did."""

    name, Config = "toy", ToyConfig
    title = summary = source = "toy"

    def __init__(self, config=None):
        super().__init__(config)
        self.nets = {"a": nn.Linear(1, 1, bias=False), "b": nn.Linear(1, 1, bias=False)}
        for net in self.nets.values():
            nn.init.zeros_(net.weight)
        self.seen: list[float] = []
        self.batches: list[torch.Tensor] = []

    def modules(self):
        return self.nets

    def averaged(self):
        return ("a",)

    def optimizers(self):
        return {key: SGD(net.parameters(), 1.0) for key, net in self.nets.items()}

    def updates(self, nets, batch):
        self.batches.append(batch.parameters)
        a, b = nets["a"].weight.sum(), nets["b"].weight.sum()
        yield Update("a", 2.0 * a + 100.0 * b, {"a": a})
        self.seen.append(float(nets["a"].weight.detach()))
        yield Update("b", 3.0 * nets["b"].weight.sum(), {"b": b})

    def learn(self, store, run):
        return train(self, store, self.config.training, run)

    def draw(self, parameters, seed):
        level = abs(float(self.nets["a"].weight.detach()))
        return torch.full((len(parameters), 128, 128), level).to(torch.uint8)

    def tensors(self):
        return {"a": self.nets["a"].weight.detach()}

    def restore(self, tensors):
        self.nets["a"].weight.data.copy_(tensors["a"])


def fit(store, folder, **training) -> tuple[Toy, dict]:
    config = ToyConfig(dataclasses.replace(ToyConfig().training, **training))
    toy = Toy(config)
    return toy, toy.fit(store, Run(folder, device="cpu", progress=False))


def test_each_update_steps_its_own_weights_before_the_next_is_asked_for(store, run_dir):
    toy, _ = fit(store, run_dir)
    assert toy.seen[:3] == [-2.0, -4.0, -6.0]
    assert float(toy.nets["a"].weight.detach()) == -20.0
    # The first loss reaches b with a gradient of 100, which must not leak into b's step.
    assert float(toy.nets["b"].weight.detach()) == -30.0


def test_clipping_bounds_a_step(store, run_dir):
    toy, _ = fit(store, run_dir, gradient_clip=0.5)
    assert toy.seen[:2] == pytest.approx([-0.5, -1.0], abs=1e-5)


def test_budget_is_counted_in_images(store, run_dir):
    toy, metrics = fit(store, run_dir, images=41)
    assert (metrics["images"], metrics["steps"]) == (44, 11)
    assert sum(map(len, toy.batches)) == 44
    written = json.loads((run_dir / "metrics.json").read_text())
    assert written["images"] == 44 and written["generator"] == "toy"


def test_curves_have_a_row_an_interval_and_no_experiment(store, run_dir):
    fit(store, run_dir, log_every=10)
    rows = (run_dir / "dvclive/plots/metrics/a.tsv").read_text().splitlines()
    assert [row.split("\t")[0] for row in rows] == ["step", "12", "20", "32", "40"]
    means = [float(row.split("\t")[1]) for row in rows[1:]]
    assert means == [-2.0, -7.0, -12.0, -17.0]
    assert not list(run_dir.rglob("dvc.yaml"))


def test_samples_show_truth_above_drawn(store, run_dir):
    fit(store, run_dir, sample_every=20)
    grids = sorted(path.name for path in (run_dir / "samples").iterdir())
    assert grids == ["000000020.png", "000000040.png"]
    grid = torch.tensor(list(Image.open(run_dir / "samples/000000040.png").tobytes()))
    grid = grid.view(256, 1024)
    first = store.images[store.split_indices("validation")[0]]
    assert torch.equal(grid[:128, :128], first.long())
    assert grid[128:].eq(20).all()


def test_run_leaves_no_checkpoint_and_no_partial_file(store, run_dir):
    fit(store, run_dir, checkpoint_every=8)
    assert not (run_dir / "checkpoint").exists()
    assert not list(run_dir.rglob("*.partial"))


def rates(config: Training) -> list[float]:
    """The learning rate at each step of a run, for an optimizer of rate 1."""
    return [rate_factor(config, seen) for seen in range(0, config.images, config.batch_size)]


def test_schedule_warms_up_and_falls():
    assert rates(Training(images=40, batch_size=4)) == [1.0] * 10
    warm = rates(Training(images=40, batch_size=4, warmup_images=16))
    assert warm == [0.25, 0.5, 0.75, *[1.0] * 7]
    cosine = rates(Training(images=40, batch_size=4, schedule="cosine", warmup_images=8))
    wanted = [0.5 * (1 + math.cos(math.pi * step / 8)) for step in range(8)]
    assert cosine == pytest.approx([0.5, 1.0, *wanted])


def test_schedule_moves_every_optimizer(store, run_dir):
    toy, _ = fit(store, run_dir, warmup_images=16)
    # Steps of 2 and 3 at a quarter, half, three quarters, then whole.
    assert float(toy.nets["a"].weight.detach()) == -2.0 * (1.5 + 7)
    assert float(toy.nets["b"].weight.detach()) == -3.0 * (1.5 + 7)


class Breaks(Toy):
    """Its second loss is no number from image 28 on."""

    bad = float("nan")

    def updates(self, nets, batch):
        for update in super().updates(nets, batch):
            broken = update.optimizer == "b" and len(self.batches) == 7
            yield update._replace(loss=update.loss * self.bad) if broken else update


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_loss_that_is_no_number_stops_and_keeps_the_checkpoint(store, run_dir, bad):
    config = ToyConfig(dataclasses.replace(ToyConfig().training, checkpoint_every=12))
    toy = Breaks(config)
    toy.bad = bad
    with pytest.raises(
        RacinesError, match=r"toy: loss 'b' is -?(nan|inf) between images 24 and 28"
    ):
        toy.fit(store, Run(run_dir, device="cpu", progress=False))
    state = Checkpoint(run_dir, {}).read(None)
    assert state is not None and state["seen"] == 24
    assert not (run_dir / "model.safetensors").exists()


def test_on_an_accelerator_losses_are_read_with_the_curves_only():
    guard = Guard("toy", torch.device("cuda"))
    assert not guard.every_step and Guard("toy", torch.device("cpu")).every_step
    for loss in (1.0, float("nan"), 1.0):
        guard.add({"a": torch.tensor(loss), "b": torch.tensor(1.0)})
    with pytest.raises(RacinesError, match="loss 'a' is nan between images 0 and 30"):
        guard.check(30)


@pytest.mark.parametrize("ema", [0.0, 0.9])
def test_averaging_can_be_switched(store, run_dir, ema):
    toy, _ = fit(store, run_dir, ema=ema)
    weight, average = 0.0, 0.0
    for step in range(1, 11):
        weight -= 2.0
        decay = min(ema, (1 + step) / (10 + step))
        average = decay * average + (1 - decay) * weight
    assert float(toy.nets["a"].weight.detach()) == pytest.approx(average if ema else weight)
    assert float(toy.nets["b"].weight.detach()) == -30.0


def test_average_is_put_in_and_taken_out_again():
    net = nn.BatchNorm1d(3)
    average = Average([net], 0.5)
    with torch.no_grad():
        net.weight.fill_(3.0)
    net.running_mean.fill_(7.0)
    net.num_batches_tracked.fill_(9)
    average.update()
    live = {key: value.clone() for key, value in net.state_dict().items()}
    decay = 2 / 11  # warmed up: (1 + 1) / (10 + 1)
    with average.applied():
        assert not net.training
        torch.testing.assert_close(net.weight.detach(), torch.full((3,), 3 - 2 * decay))
        torch.testing.assert_close(net.running_mean, torch.full((3,), 7 * (1 - decay)))
        assert int(net.num_batches_tracked) == 9
    assert net.training
    assert all(torch.equal(value, live[key]) for key, value in net.state_dict().items())


def test_feed_shows_every_frame_once_an_epoch(store):
    frames = len(store.split_indices("train"))
    feed = Feed(store, 7, seed=1, device="cpu")
    seen = torch.cat([batch.parameters for batch in feed.batches(0, 2 * frames)])
    assert seen[:frames].unique(dim=0).shape == (frames, 12)
    assert seen[frames : 2 * frames].unique(dim=0).shape == (frames, 12)
    assert not torch.equal(seen[:frames], seen[frames : 2 * frames])
    assert not torch.equal(seen[:frames], store.parameters[:frames])


def test_feed_starts_anywhere(store):
    whole = list(Feed(store, 8, seed=1, device="cpu").batches(0, 400))
    late = list(Feed(store, 8, seed=1, device="cpu").batches(160, 400))
    for a, b in zip(whole[20:], late, strict=True):
        assert all(torch.equal(x, y) for x, y in zip(a, b, strict=True))
    other = next(Feed(store, 8, seed=2, device="cpu").batches(0, 8))
    assert not torch.equal(other.parameters, whole[0].parameters)
    seeds = torch.cat([batch.seeds for batch in whole])
    assert len(seeds.unique()) == len(seeds)


def test_mixed_precision_trains_and_half_on_a_cpu_is_refused(store, tmp_path):
    _, metrics = fit(store, tmp_path / "bf16", precision="bf16")
    assert metrics["precision"] == "bf16"
    _, metrics = fit(store, tmp_path / "auto", precision="auto")
    assert metrics["precision"] == resolve_precision("auto", "cpu")
    with pytest.raises(RacinesError, match="fp16"):
        fit(store, tmp_path / "fp16", precision="fp16")


@pytest.mark.parametrize(
    "change",
    [
        {"images": 0},
        {"batch_size": 1},
        {"precision": "int4"},
        {"ema": 1.0},
        {"log_every": 0},
        {"schedule": "linear"},
        {"warmup_images": -1},
        {"warmup_images": 24_000},
    ],
    ids=str,
)
def test_impossible_settings_are_refused(change):
    with pytest.raises(RacinesError, match="training"):
        Training(**change)


def test_absent_device_is_refused(store, tmp_path):
    if torch.cuda.is_available():
        pytest.skip("there is a CUDA device")
    with pytest.raises(RacinesError, match="use auto, cpu"):
        Toy().fit(store, Run(tmp_path, device="cuda"))
