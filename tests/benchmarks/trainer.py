"""What precision and `torch.compile` bring, and what logs and checkpoints of a training cost.

    OMP_NUM_THREADS=1 python -m tests.benchmarks.trainer docs/results/trainer.json

Each generator is trained for some steps in each way, one after the other, in turns. A rate is that
of the median step; what the first steps took beyond it is told as preparation. The share of logs,
validation and checkpoints is their time at the default intervals beside that of the steps between.
Of the environments the oracle and the contact of 64 probes are compiled.
"""

import argparse
import os
import statistics
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
from racines_models.devices import has_bfloat16
from racines_models.protocol import Run
from racines_models.provenance import environment
from racines_models.registry import generator_class
from racines_models.training import log, trainer
from racines_models.training.objective import Training
from tests.benchmarks.turns import in_turns, rate

NAMES = ("vae-gan", "flow")
WAYS = {"float32": ("fp32", "no"), "bfloat16": ("bf16", "no"), "compiled": ("fp32", "inductor")}
"""By name the precision, and accelerate's backend of `torch.compile`."""
ROUNDS, STEPS, FIRST, BATCH = 2, 20, 5, 16
DEFAULT = Training()
EVERY = {
    "log": DEFAULT.log_every,
    "validation": DEFAULT.sample_every,
    "checkpoint": DEFAULT.checkpoint_every,
}
Seconds = dict[str, list[float]]


def main() -> None:
    """Measure, and write the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    out = parser.parse_args().out
    figures: dict[str, Any] = {"units": has_bfloat16("cpu")}
    with tempfile.TemporaryDirectory() as folder:
        config = DataConfig(frames=1_200, workers=1)
        build(make_source(config), Path(folder) / "data", config)
        store = open_store(Path(folder) / "data")
        for name in NAMES:
            figures[name] = measured(name, store, Path(folder))
            print(name, figures[name], flush=True)
    figures["truth"] = of_truth()
    print(figures["truth"])
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


def measured(name: str, store: FrameStore, folder: Path) -> dict[str, Any]:
    """Return a generator's figures."""
    told: dict[str, list[Seconds]] = {way: [] for way in WAYS}
    for turn in range(ROUNDS):
        for way, (precision, backend) in WAYS.items():
            run = Run(folder / f"{name}-{way}-{turn}", 0, "cpu", False, progress=False)
            settings = {"images": STEPS * BATCH, "batch_size": BATCH, "precision": precision}
            settings |= {"log_every": FIRST * BATCH, "sample_every": FIRST * BATCH}
            settings |= {"checkpoint_every": FIRST * BATCH}
            cls: Any = generator_class(name)
            generator = cls(fill(cls.Config, {"training": settings}, name))
            with timed() as seconds, patch.dict(os.environ, ACCELERATE_DYNAMO_BACKEND=backend):
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


@contextmanager
def timed() -> Iterator[Seconds]:
    """Time each step of the trainer, row of the log, look and checkpoint within the block."""
    seconds: Seconds = defaultdict(list)

    def wrapped(what: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def work(*arguments: Any) -> Any:
            start = time.perf_counter()
            try:
                return call(*arguments)
            finally:
                seconds[what].append(time.perf_counter() - start)

        return work

    own = trainer._Trainer
    parts = (
        ("step", own, "step"), ("log", log.TrainingLog, "row"),
        ("validation", own, "look"), ("checkpoint", own, "write_checkpoint"),
    )  # fmt: skip
    held = [patch.object(cls, name, wrapped(what, getattr(cls, name))) for what, cls, name in parts]
    for each in held:
        each.start()
    try:
        yield seconds
    finally:
        for each in held:
            each.stop()


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
        for name in NAMES
    ]
    return {"columns": ["generator", *EVERY], "right": 1, "rows": rows}


if __name__ == "__main__":
    main()
