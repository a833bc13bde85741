"""A run that was killed and resumed ends in the bits of an undisturbed one."""

import dataclasses
import json
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from racines_data.errors import RacinesError
from racines_models.generators.flow import Flow, FlowConfig
from racines_models.generators.vae_gan import VaeGan, VaeGanConfig
from racines_models.protocol import Run
from racines_models.training.objective import Training
from tests.conftest import ROOT
from tests.models.conftest import FakeStore
from tests.waiting import until

CONFIG = VaeGanConfig(
    width=2,
    encoder_width=2,
    discriminator_width=2,
    latent=4,
    embedding=4,
    training=Training(
        images=160,
        batch_size=8,
        precision="fp32",
        log_every=24,
        sample_every=64,
        checkpoint_every=40,
    ),
)


class Killed(Exception):
    """Stands for whatever ends a process."""


def die() -> None:
    raise Killed


def mortal(generator, dies_at: int, end: Callable[[], None] = die):
    """Let a generator die, or come to another end, when it is asked for a given step."""
    inner, steps = generator.updates, iter(range(1, 10**9))

    def updates(nets, batch):
        if next(steps) == dies_at:
            end()
        yield from inner(nets, batch)

    generator.updates = updates
    return generator


def fit(
    folder: Path, make=VaeGan, config=CONFIG, resume=None, dies_at=0, seed=0, store=None, end=die
) -> dict:
    generator = mortal(make(config), dies_at, end)
    run = Run(folder, seed=seed, device="cpu", resume=resume, progress=False)
    return generator.fit(store or FakeStore(train=60), run)


def kill(folder: Path, **options) -> None:
    with pytest.raises(Killed):
        fit(folder, dies_at=14, **options)
    assert (folder / "checkpoint/last.pt").is_file()


def weights(folder: Path) -> bytes:
    return (folder / "model.safetensors").read_bytes()


def curves(folder: Path) -> dict[str, str]:
    files = sorted((folder / "dvclive/plots").rglob("*.tsv"))
    return {str(path.relative_to(folder)): path.read_text() for path in files}


def test_killed_and_resumed_equals_undisturbed(tmp_path):
    whole = fit(tmp_path / "whole")
    kill(tmp_path / "killed")
    resumed = fit(tmp_path / "killed", resume=True)
    assert weights(tmp_path / "killed") == weights(tmp_path / "whole")
    assert curves(tmp_path / "killed") == curves(tmp_path / "whole")
    for key in ("images", "steps", "losses", "validation"):
        assert resumed[key] == whole[key]
    assert not (tmp_path / "killed/checkpoint").exists()


def test_resuming_does_not_start_over(tmp_path):
    kill(tmp_path / "run")
    # Steps are counted from the checkpoint at image 80 of 160: ten are left.
    with pytest.raises(Killed):
        fit(tmp_path / "run", dies_at=10)
    fit(tmp_path / "run", dies_at=11)


def test_fresh_forgets_the_checkpoint(tmp_path):
    kill(tmp_path / "run")
    with pytest.raises(Killed):
        fit(tmp_path / "run", resume=False, dies_at=20)


def test_resume_without_a_checkpoint_is_refused(tmp_path):
    with pytest.raises(RacinesError, match="cannot resume: there is none; use --fresh"):
        fit(tmp_path, resume=True)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"config": dataclasses.replace(CONFIG, learning_rate=0.5)}, "config"),
        ({"seed": 9}, "seed"),
        ({"store": FakeStore(seed=4, train=60)}, "data"),
    ],
    ids=["config", "seed", "data"],
)
def test_checkpoint_of_another_run_is_not_continued(tmp_path, change, named):
    kill(tmp_path / "run")
    with pytest.raises(RacinesError, match=f"made with another {named};"):
        fit(tmp_path / "run", resume=True, **change)
    fit(tmp_path / "run", **change)
    fit(tmp_path / "clean", **change)
    assert weights(tmp_path / "run") == weights(tmp_path / "clean")


def test_damaged_checkpoint_is_not_continued(tmp_path):
    kill(tmp_path / "run")
    path = tmp_path / "run/checkpoint/last.pt"
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(RacinesError, match="cannot be read"):
        fit(tmp_path / "run", resume=True)
    fit(tmp_path / "run")
    fit(tmp_path / "clean")
    assert weights(tmp_path / "run") == weights(tmp_path / "clean")


SCRIPT = """
import sys
from pathlib import Path
import torch
from tests.models import test_trainer_resume as here
from tests.waiting import halt
torch.set_num_threads(1)
here.fit(Path(sys.argv[2]), *here.LONG[sys.argv[1]], dies_at=50, end=halt)
"""
TRAINING = dataclasses.replace(
    CONFIG.training, images=480, checkpoint_every=80, schedule="cosine", warmup_images=64
)
LONG = {
    "vae-gan": (VaeGan, dataclasses.replace(CONFIG, training=TRAINING)),
    "flow": (Flow, FlowConfig(width=8, octaves=2, training=TRAINING)),
}
"""One with two optimizers, batch norm and a frozen network; one with group norm and one of each."""


@pytest.mark.slow
@pytest.mark.docs
@pytest.mark.parametrize("name", LONG)
def test_sigkill_at_any_moment(tmp_path, name):
    """The process is killed once its first checkpoint stands, wherever it is by then.

    The checkpoint is written after 10 of 60 steps; it never goes beyond the fiftieth.
    """
    torch.set_num_threads(1)
    command = [sys.executable, "-c", SCRIPT, name, str(tmp_path / "killed")]
    process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE)
    until((tmp_path / "killed/checkpoint/last.pt").exists, process)
    process.kill()
    assert process.wait() == -signal.SIGKILL
    assert not (tmp_path / "killed/model.safetensors").exists()
    fit(tmp_path / "killed", *LONG[name], resume=True)
    fit(tmp_path / "whole", *LONG[name])
    assert weights(tmp_path / "killed") == weights(tmp_path / "whole")
    assert curves(tmp_path / "killed") == curves(tmp_path / "whole")
    config = json.loads((tmp_path / "killed/config.json").read_text())
    assert config["config"]["training"]["images"] == 480
