"""A run that was killed and resumed ends in the bits of an undisturbed one."""

import dataclasses
import json
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from racines_data.errors import RacinesError
from racines_models.generators.vae_gan import VaeGan, VaeGanConfig
from racines_models.protocol import Run
from racines_models.training.checkpoint import Checkpoint
from racines_models.training.log import TrainingLog
from racines_models.training.objective import Training
from tests.conftest import ROOT
from tests.models.conftest import FakeStore
from tests.models.training.learners import LEARNERS, learn
from tests.variants import first_of
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


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The folder of a run that came to its end, and what it told."""
    folder = tmp_path_factory.mktemp("undisturbed")
    return folder, fit(folder)


@pytest.fixture(scope="module")
def dead(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dead")
    kill(folder)
    return folder


@pytest.fixture
def killed(dead, tmp_path):
    """The folder of a run that was killed."""
    return shutil.copytree(dead, tmp_path / "run")


def test_killed_and_resumed_equals_undisturbed(killed, undisturbed):
    folder, whole = undisturbed
    resumed = fit(killed, resume=True)
    assert weights(killed) == weights(folder)
    assert curves(killed) == curves(folder)
    for key in ("images", "steps", "losses", "validation"):
        assert resumed[key] == whole[key]
    assert not (killed / "checkpoint").exists()


def test_resuming_does_not_start_over(killed):
    # Steps are counted from the checkpoint at image 80 of 160: ten are left.
    with pytest.raises(Killed):
        fit(killed, dies_at=10)
    fit(killed, dies_at=11)


def test_fresh_forgets_the_checkpoint(killed):
    with pytest.raises(Killed):
        fit(killed, resume=False, dies_at=20)


def test_resume_without_a_checkpoint_is_refused(tmp_path):
    with pytest.raises(RacinesError, match="cannot resume: there is none; use --fresh"):
        fit(tmp_path, resume=True)


OTHERS = {
    "config": {"config": dataclasses.replace(CONFIG, learning_rate=0.5)},
    "seed": {"seed": 9},
    "data": {"store": FakeStore(seed=4, train=60)},
}


@pytest.mark.parametrize("named", OTHERS)
def test_checkpoint_of_another_run_is_not_continued(killed, named):
    with pytest.raises(RacinesError, match=f"made with another {named};"):
        fit(killed, resume=True, **OTHERS[named])


@pytest.mark.parametrize("named", first_of(OTHERS))
def test_beside_the_checkpoint_of_another_run_a_run_starts_anew(killed, tmp_path, named):
    change = OTHERS[named]
    fit(killed, **change)
    fit(tmp_path / "clean", **change)
    assert weights(killed) == weights(tmp_path / "clean")


def test_damaged_checkpoint_is_not_continued(killed, undisturbed):
    path = killed / "checkpoint/last.pt"
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(RacinesError, match="cannot be read"):
        fit(killed, resume=True)
    fit(killed)
    assert weights(killed) == weights(undisturbed[0])


@pytest.mark.thorough
@pytest.mark.parametrize("name", LEARNERS)
def test_every_learner_ends_in_the_same_bits_after_two_deaths(tmp_path, name, monkeypatch):
    learn(name, tmp_path / "whole")
    write, written = Checkpoint.write, []

    def write_then_die(self, state):
        write(self, state)
        written.append(state["seen"])
        if len(written) in DEATHS[name]:
            raise Killed

    monkeypatch.setattr(Checkpoint, "write", write_then_die)
    for resume in (None, True):
        with pytest.raises(Killed):
            learn(name, tmp_path / "killed", resume)
        assert not list((tmp_path / "killed").glob("*.safetensors"))
    learn(name, tmp_path / "killed", True)
    assert written == sorted(set(written)), "nothing was trained twice"
    assert bits(tmp_path / "killed") == bits(tmp_path / "whole")
    assert not (tmp_path / "killed/checkpoint").exists()
    training = json.loads((tmp_path / "killed/metrics.json").read_text())
    training = training.get("training", training)
    assert training["images"] == written[-1] and training["images_per_second"] > 0


DEATHS: dict[str, tuple[int, int]] = dict.fromkeys(LEARNERS, (1, 2))
"""At which checkpoints it dies; the grader in each of its stages, a checkpoint being a step."""
DEATHS |= {"grader": (5, 15), "student": (3, 8)}


def bits(folder: Path) -> dict[str, bytes]:
    """The bytes of weights and curves."""
    files = [*folder.glob("*.safetensors"), *(folder / "dvclive/plots").rglob("*.tsv")]
    assert len(files) > 1
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


SCRIPT = """
import sys
from pathlib import Path
import torch
from racines_models.training.checkpoint import Checkpoint
from racines_models.training.log import TrainingLog
from tests.models.training.learners import learn
from tests.waiting import halt
torch.set_num_threads(1)
write, written = Checkpoint.write, []
def write_then_halt(self, state):
    write(self, state)
    written.append(state)
    if len(written) == 3:
        halt()
Checkpoint.write = write_then_halt
learn(sys.argv[1], Path(sys.argv[2]))
"""


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("name", LEARNERS)
def test_sigkill_at_any_moment(tmp_path, name):
    """The process is killed once its first checkpoint stands, wherever it is by then.

    It never goes beyond the third.
    """
    torch.set_num_threads(1)
    command = [sys.executable, "-c", SCRIPT, name, str(tmp_path / "killed")]
    process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE)
    until((tmp_path / "killed/checkpoint/last.pt").exists, process)
    process.kill()
    assert process.wait() == -signal.SIGKILL
    assert not list((tmp_path / "killed").glob("*.safetensors"))
    learn(name, tmp_path / "killed", True)
    learn(name, tmp_path / "whole")
    assert bits(tmp_path / "killed") == bits(tmp_path / "whole")


def test_latest_values_that_a_kill_tore_do_not_stop_the_run_that_goes_on(tmp_path):
    with TrainingLog(tmp_path, "run", 0, 8, visible=False) as log:
        log.add({"loss": torch.tensor(1.0)})
        log.row(4)
    (tmp_path / "dvclive" / "metrics.json").write_text('{"loss": 1.')
    with TrainingLog(tmp_path, "run", 4, 8, visible=False) as log:
        log.add({"loss": torch.tensor(0.5)})
        log.row(8)
    assert json.loads((tmp_path / "dvclive" / "metrics.json").read_text())
