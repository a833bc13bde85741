"""What precision and `torch.compile` bring, and what logs and checkpoints of a training cost.

    OMP_NUM_THREADS=1 python -m tests.benchmarks.trainer docs/results/trainer.json [PART...]

Each generator is trained for some steps in each way, one after the other, in turns. A rate is that
of the median step; what the first steps took beyond it is told as preparation. The share of logs,
validation and checkpoints is their time at the default intervals beside that of the steps between;
of PPO, beside that of acting and learning. Of the environments the oracle and the contact of 64
probes are compiled. The parts that are named (a generator, `ppo`, `truth`) are measured, the others
kept.
"""

import json
import statistics
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import torch
from gymnasium import make_vec
from torch import Tensor

from racines_data.build.dataset import DataConfig, build, make_source
from racines_data.config import fill
from racines_data.files import write_json
from racines_data.geometry import Pose
from racines_data.store.frames import FrameStore, open_store
from racines_envs.agents.ppo import PPOAgent, PPOConfig
from racines_envs.agents.training import TrainingRun
from racines_models.devices import has_bfloat16
from racines_models.protocol import Run
from racines_models.provenance import environment
from racines_models.registry import generator_class
from racines_models.training import log, trainer
from racines_models.training.checkpoint import Checkpoint
from racines_models.training.objective import Training
from tests.benchmarks.turns import in_turns, rate

NAMES = ("vae-gan", "flow")
PARTS = (*NAMES, "ppo", "truth")
WAYS = {"float32": ("fp32", False), "bfloat16": ("bf16", False), "compiled": ("fp32", True)}
"""By name the precision, and whether the networks are compiled."""
ROUNDS, STEPS, FIRST, BATCH = 2, 20, 5, 16
DEFAULT, POLICY = Training(), PPOConfig()
EVERY = {
    "log": DEFAULT.log_every,
    "validation": DEFAULT.sample_every,
    "checkpoint": DEFAULT.checkpoint_every,
}
EVERY_FRAMES = {
    "log": POLICY.update_every,
    "validation": POLICY.validate_every,
    "checkpoint": POLICY.validate_every,
}
"""Images, and environment steps of PPO, between two of each."""
SOME = 2 * POLICY.update_every
"""Environment steps between two validations of the PPO that is measured."""
TRAINER = (
    ("step", trainer._Trainer, "step"), ("log", log.TrainingLog, "row"),
    ("validation", trainer._Trainer, "look"),
    ("checkpoint", trainer._Trainer, "write_checkpoint"),
)  # fmt: skip
ACTING = (
    ("loop", TrainingRun, "_loop"), ("log", TrainingRun, "_log"),
    ("validation", TrainingRun, "_validate"), ("checkpoint", Checkpoint, "write"),
)  # fmt: skip
Seconds = dict[str, list[float]]


def main(out: Path, *names: str) -> None:
    """Measure the parts, or those that are named, and write the file."""
    kept = json.loads(out.read_text(encoding="utf-8"))["parts"] if out.is_file() else {}
    figures: dict[str, Any] = {**kept}
    with tempfile.TemporaryDirectory() as folder:
        for name in names or PARTS:
            figures[name] = OTHERS[name]() if name in OTHERS else measured(name, Path(folder))
            if name in NAMES:
                figures["units"] = has_bfloat16("cpu")
            print(name, figures[name], flush=True)
    where = environment("cpu")
    write_json(out, {
        "schema": "racines.figures/1",
        "what": "precision, torch.compile, logs and checkpoints of the trainer",
        "command": f"OMP_NUM_THREADS=1 python -m tests.benchmarks.trainer {out}",
        "machine": f"{where['cpu']}, one thread, torch {where['torch']}",
        "source": "measured once",
        "parts": figures,
        "tables": {"ways": ways_table(figures), "shares": shares_table(figures)},
    })  # fmt: skip


def dataset(folder: Path) -> FrameStore:
    """Return a small dataset in a folder; made if it is missing."""
    config = DataConfig(frames=1_200, workers=1)
    if not (folder / "data").is_dir():
        build(make_source(config), folder / "data", config)
    return open_store(folder / "data")


def measured(name: str, folder: Path) -> dict[str, Any]:
    """Return a generator's figures."""
    store = dataset(folder)
    told: dict[str, list[Seconds]] = {way: [] for way in WAYS}
    for turn in range(ROUNDS):
        for way, (precision, compiled) in WAYS.items():
            run = Run(folder / f"{name}-{way}-{turn}", 0, "cpu", False, progress=False)
            settings = {"images": STEPS * BATCH, "batch_size": BATCH, "precision": precision}
            settings |= {"log_every": FIRST * BATCH, "sample_every": FIRST * BATCH}
            settings |= {"checkpoint_every": FIRST * BATCH, "compile": compiled}
            cls: Any = generator_class(name)
            generator = cls(fill(cls.Config, {"training": settings}, name))
            with timed(TRAINER) as seconds:
                generator.fit(store, run)
            told[way].append(seconds)
    figures: dict[str, Any] = {}
    for way, rounds in told.items():
        steps = [statistics.median(each["step"][FIRST:]) for each in rounds]
        ready = [
            sum(each["step"][:FIRST]) - FIRST * one for each, one in zip(rounds, steps, strict=True)
        ]
        figures[way] = {
            "images_per_second": BATCH / statistics.median(steps),
            "preparation_seconds": ready[0],
            "preparation_seconds_again": min(ready[1:]),
        }
    images = figures["float32"]["images_per_second"]
    figures["share"] = {
        what: statistics.median(sum((each[what] for each in told["float32"]), [])) * images / every
        for what, every in EVERY.items()
    }
    return figures


def of_ppo() -> dict[str, Any]:
    """Return the share of what PPO, which learns from the pose, tells and keeps."""
    config = replace(POLICY, frames=8 * SOME, validate_every=SOME)
    with tempfile.TemporaryDirectory() as folder, timed(ACTING) as seconds:
        PPOAgent.train(config, Path(folder), progress=False)
    apart = [
        one - other for one, other in zip(seconds["validation"], seconds["checkpoint"], strict=True)
    ]
    frames = config.frames / (sum(seconds["loop"]) - sum(seconds["log"] + seconds["validation"]))
    seconds["validation"] = apart  # it ends with the checkpoint
    share = {
        what: statistics.median(seconds[what]) * frames / every
        for what, every in EVERY_FRAMES.items()
    }
    return {"share": share}


def of_truth() -> dict[str, float]:
    """Return what the truth and the wrench of 64 probes cost an environment, compiled or not."""
    env = make_vec("racines_envs:racines/SC-v0", num_envs=64, observation="params", reward="oracle")
    core = env.unwrapped.core  # pyright: ignore[reportAttributeAccessIssue]
    env.reset(seed=0)
    scene = core.scene()

    def eager(pose: Pose) -> tuple[Tensor, ...]:
        return *scene.judge_alike(pose), core.wrench(pose)

    start = time.perf_counter()
    compiled: Any = torch.compile(eager, dynamic=False)
    pose = core.state.pose
    apart = [
        float((one.double() - other.double()).abs().max())
        for one, other in zip(eager(pose), compiled(pose), strict=True)
    ]
    ready = time.perf_counter() - start
    calls = {"eager": eager, "compiled": compiled}
    sides = {
        name: lambda call=call: [call(pose) for _ in range(200)] for name, call in calls.items()
    }
    told = {f"{name}_ms": 1e3 / rate(200, took) for name, took in in_turns(sides, 5).items()}
    return told | {"apart": max(apart), "preparation_seconds": ready}


OTHERS: dict[str, Callable[[], dict[str, Any]]] = {"ppo": of_ppo, "truth": of_truth}


@contextmanager
def timed(parts: Iterable[tuple[str, type, str]]) -> Iterator[Seconds]:
    """Time each call of some methods, each by a name of its own, within the block."""
    seconds: Seconds = defaultdict(list)

    def wrapped(what: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def work(*arguments: Any) -> Any:
            start = time.perf_counter()
            try:
                return call(*arguments)
            finally:
                seconds[what].append(time.perf_counter() - start)

        return work

    with ExitStack() as held:
        for what, cls, name in parts:
            held.enter_context(patch.object(cls, name, wrapped(what, getattr(cls, name))))
        yield seconds


def ways_table(figures: dict[str, Any]) -> dict[str, Any]:
    """Return the table of images a second."""
    columns = ["generator", "float32, images/s", "bfloat16", "compiled"]
    rows = []
    for name in NAMES:
        rates = {way: figures[name][way]["images_per_second"] for way in WAYS}
        times = [f"{rates[way]:.1f} ({rates[way] / rates['float32']:.2f} ×)" for way in WAYS][1:]
        rows.append([f"`{name}`", f"{rates['float32']:.1f}", *times])
    return {"columns": columns, "right": 1, "rows": rows}


def shares_table(figures: dict[str, Any]) -> dict[str, Any]:
    """Return the table of what is not training."""
    rows = [
        [f"`{name}`", *(f"{100 * figures[name]['share'][what]:.2f} %" for what in EVERY)]
        for name in (*NAMES, "ppo")
    ]
    return {"columns": ["training", *EVERY], "right": 1, "rows": rows}


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
