"""Several processes train as one, and a killed one of them ends the others."""

import dataclasses
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file
from torch import nn
from torch.optim import SGD

from racines_data.errors import RacinesError
from racines_models.generators.flow import Flow, FlowConfig
from racines_models.generators.vae_gan import VaeGan
from racines_models.networks.layers import frozen
from racines_models.protocol import Run
from racines_models.training.objective import Feed, Training, Update
from racines_models.training.processes import in_processes
from tests.conftest import ROOT
from tests.models.conftest import FakeStore
from tests.models.training.test_trainer import Toy, ToyConfig
from tests.models.training.test_trainer_resume import CONFIG, curves, mortal
from tests.waiting import descendants, until, until_ended

TRAINING = Training(
    images=96, batch_size=8, precision="fp32", ema=0.5, log_every=32, checkpoint_every=32
)
FLOW = FlowConfig(width=8, octaves=2, steps=1, training=TRAINING)
VAE = dataclasses.replace(CONFIG, training=TRAINING)


class Adversaries(Toy):
    """Two networks against each other: one is called three times, and frozen once.

    Nothing depends on the batch but through means, so the share of a process does not matter.
    """

    def __init__(self, config=None):
        super().__init__(config)
        torch.manual_seed(0)
        self.nets = {"a": nn.Linear(12, 4), "b": nn.Linear(4, 1)}

    def optimizers(self):
        return {key: SGD(net.parameters(), 0.01) for key, net in self.nets.items()}

    def updates(self, nets, batch):
        x = batch.parameters
        made = nets["a"](x)
        real = nets["b"](x[:, 6:10]).square().mean()
        verdict = real - nets["b"](made.detach()).tanh().mean()
        yield Update("b", verdict, {"verdict": verdict})
        with frozen(self.nets["b"]):
            loss = nets["b"](made).tanh().mean() + made.square().mean()
        yield Update("a", loss, {"loss": loss})

    def draw(self, parameters, seed):
        return torch.zeros(len(parameters), 128, 128, dtype=torch.uint8)

    def tensors(self):
        return {
            f"{k}.{n}": v.detach()
            for k, net in self.nets.items()
            for n, v in net.named_parameters()
        }


def fit(make, config, folder: Path, dies_at: int = 0, resume: bool | None = None) -> dict:
    """Train on the fake frames; importable, so that other processes can be told to."""
    torch.set_num_threads(1)
    generator = mortal(make(config), dies_at)
    run = Run(folder, device="cpu", resume=resume, progress=False)
    return generator.fit(FakeStore(train=60), run)


def drift(a: Path, b: Path) -> float:
    """Root mean square difference of two runs' learned numbers, batch norm's counters aside."""
    first, second = (load_file(folder / "model.safetensors") for folder in (a, b))
    squares = [(first[key] - second[key]).double().square().flatten() for key in first]
    return float(torch.cat(squares).mean().sqrt())


def test_feed_shares_each_batch(store):
    whole = list(Feed(store, 8, 1, "cpu").batches(0, 64))
    shares = [
        list(Feed(store, 8, 1, "cpu", slice(4 * i, 4 * i + 4)).batches(0, 64)) for i in (0, 1)
    ]
    for batch, left, right in zip(whole, *shares, strict=True):
        for column, halves in zip(batch, zip(left, right, strict=True), strict=True):
            assert torch.equal(column, torch.cat(halves))


KINDS = {
    "adversaries": (Adversaries, ToyConfig(TRAINING), 1e-6),
    "flow": (Flow, FLOW, 1e-4),
    "vae-gan": (VaeGan, VAE, 0.02),
}
"""What is trained, how, and how far apart one and two processes may end."""


def fit_each(folder: Path) -> dict[str, dict]:
    return {name: fit(make, config, folder / name) for name, (make, config, _) in KINDS.items()}


@pytest.fixture(scope="module")
def ends(tmp_path_factory, warm_workers) -> tuple[Path, dict[str, dict], dict[str, dict]]:
    """Folders and metrics of each kind, trained by one process and by two that started once."""
    folder = tmp_path_factory.mktemp("ends")
    return folder, fit_each(folder / "one"), in_processes(2, fit_each, folder / "two")


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_two_processes_end_near_one(ends, kind):
    """Without batch norm weights differ by rounding; vae-gan has it, and sees half a batch."""
    folder, one, two = ends[0], ends[1][kind], ends[2][kind]
    assert (one["processes"], two["processes"]) == (1, 2)
    assert one["images"] == two["images"] == 96
    assert 0.0 < drift(folder / "one" / kind, folder / "two" / kind) < KINDS[kind][2]
    for name, loss in one["losses"].items():
        assert two["losses"][name] == pytest.approx(loss, rel=0.2, abs=0.05)


@pytest.mark.slow
@pytest.mark.thorough
def test_two_processes_resume_exactly(tmp_path):
    """One process of two dies; the other is ended, and a resumed pair ends as one undisturbed."""
    in_processes(2, fit, Flow, FLOW, tmp_path / "whole")
    with pytest.raises(RacinesError, match="process . of 2: it ended with exit code"):
        in_processes(2, fit, Flow, FLOW, tmp_path / "killed", 7)
    assert (tmp_path / "killed/checkpoint/last.pt").is_file()
    in_processes(2, fit, Flow, FLOW, tmp_path / "killed", 0, True)
    files = (tmp_path / name / "model.safetensors" for name in ("whole", "killed"))
    whole, killed = map(load_file, files)
    assert all(torch.equal(whole[key], killed[key]) for key in whole)
    assert curves(tmp_path / "whole") == curves(tmp_path / "killed")


@pytest.mark.usefixtures("warm_workers")
def test_refusals_reach_the_caller(tmp_path):
    config = dataclasses.replace(FLOW, training=dataclasses.replace(TRAINING, batch_size=9))
    with pytest.raises(RacinesError, match="process . of 2: .*9 images cannot be shared by 2"):
        in_processes(2, fit, Flow, config, tmp_path)
    assert not (tmp_path / "model.safetensors").exists()


def test_lone_process_of_a_launch_is_refused(tmp_path, monkeypatch):
    """`accelerate launch --cpu --num_processes 2` without MPI."""
    monkeypatch.setenv("ACCELERATE_USE_CPU", "True")
    monkeypatch.setenv("MASTER_ADDR", "127.0.0.1")
    with pytest.raises(RacinesError, match="--processes N"):
        fit(Flow, FLOW, tmp_path)


SCRIPT = """
import dataclasses
import sys
from pathlib import Path
from racines_models.training.processes import in_processes
from tests.models.training import test_trainer_processes as here
if __name__ == "__main__":
    training = dataclasses.replace(here.TRAINING, images=80_000_000)
    config = dataclasses.replace(here.FLOW, training=training)
    in_processes(2, here.fit, here.Flow, config, Path(sys.argv[1]))
"""


@pytest.mark.slow
@pytest.mark.thorough
def test_killed_command_leaves_no_process_behind(tmp_path):
    (tmp_path / "script.py").write_text(SCRIPT)
    process = subprocess.Popen(
        [sys.executable, tmp_path / "script.py", tmp_path],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stderr=subprocess.DEVNULL,
    )
    until((tmp_path / "checkpoint/last.pt").exists, process)
    workers = descendants(process)
    assert len(workers) >= 2
    process.send_signal(signal.SIGKILL)
    process.wait()
    until_ended(workers)
