"""Everything that the trainer trains, at a size of seconds: to be killed and resumed."""

import dataclasses
from pathlib import Path
from typing import Any

import torch

from racines_envs.agents.behaviour_cloning import BehaviourCloningAgent
from racines_models.generators.flow import Flow
from racines_models.generators.vae_gan import VaeGan
from racines_models.judges.grader.model import Grader, GraderConfig, GraderNetwork, StageConfig
from racines_models.judges.grader.training import train_grader
from racines_models.judges.pose.regressor import PoseConfig, PoseTraining
from racines_models.judges.pose.training import train_pose
from racines_models.judges.student.model import StudentConfig
from racines_models.judges.student.training import train_student
from racines_models.protocol import Run
from racines_models.training.objective import Training
from tests.envs.agents import test_behaviour_cloning as cloning
from tests.envs.fakes import FakePhantom
from tests.models.conftest import FakeStore
from tests.models.judges.test_pose import PosedStore
from tests.models.labelled import LabelledStore

TRAINING = Training(
    images=160,
    batch_size=8,
    precision="fp32",
    log_every=24,
    sample_every=64,
    checkpoint_every=40,
    schedule="cosine",
    warmup_images=64,
)
STAGE = StageConfig(epochs=1, encoder_rate=0.3, grade_weight=0.5)
JUDGE: dict[str, Any] = {"input_size": 32, "width": 0.125, "bf16": False, "checkpoint_seconds": 0.0}


def _generator(cls: Any, run: Run, **settings: Any) -> None:
    cls(cls.Config(training=TRAINING, **settings)).fit(FakeStore(train=60), run)


def _vae_gan(run: Run) -> None:
    widths = {"width": 2, "encoder_width": 2, "discriminator_width": 2}
    _generator(VaeGan, run, latent=4, embedding=4, **widths)


def _flow(run: Run) -> None:
    _generator(Flow, run, width=8, octaves=2)


def _pose(run: Run) -> None:
    fields = {each.name: getattr(TRAINING, each.name) for each in dataclasses.fields(TRAINING)}
    train_pose(PosedStore(), PoseConfig(width=0.125, training=PoseTraining(**fields)), run)


def _grader(run: Run) -> None:
    stages = {"view_stage": StageConfig(epochs=1), "grade_stage": STAGE}
    config = GraderConfig(batch_size=16, ema=0.9, **stages, **JUDGE)
    train_grader(LabelledStore(trajectories=20), config, run)


def _student(run: Run) -> None:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        teacher = Grader(GraderNetwork(32, 0.125), GraderConfig(bf16=False, input_size=32))
    config = StudentConfig(batch_size=32, epochs=3, **JUDGE)
    train_student(LabelledStore(trajectories=20), config, run, teacher)


def _cloning(run: Run) -> None:
    phantom = FakePhantom(reach=2.0)
    store: Any = cloning.sweeps(phantom, 10)
    config = dataclasses.replace(cloning.TINY, ema=0.9)
    where = {"seed": run.seed, "resume": run.resume, "progress": False}
    BehaviourCloningAgent.train(config, run.folder, data=store, phantom=phantom, **where)


LEARNERS = {
    "vae-gan": _vae_gan,
    "flow": _flow,
    "pose": _pose,
    "grader": _grader,
    "student": _student,
    "behaviour-cloning": _cloning,
}
"""Two optimizers, batch norm and a frozen network; group norm; a whole and a half ResNet; two
stages with an optimizer each, averaged; soft labels beside the checkpoint; the best of epochs."""


def learn(name: str, folder: Path, resume: bool | None = None) -> None:
    """Train one of them, or go on."""
    LEARNERS[name](Run(folder, device="cpu", resume=resume, progress=False))
