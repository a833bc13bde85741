"""What bfloat16 costs a processor without units for it, in training and in grading.

    OMP_NUM_THREADS=1 python -m tests.benchmarks.bfloat16 docs/results/bfloat16.json

Each rate is the median of seven rounds, taken in turns in one process. What both ways say of
the same frames of the phantom is compared.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from racines_data.files import write_json
from racines_data.geometry import Pose
from racines_data.phantom import shared_phantom
from racines_models.devices import has_bfloat16
from racines_models.judges.grader.model import Grader
from racines_models.networks import batching
from racines_models.provenance import environment
from tests.benchmarks.turns import in_turns, rate

JUDGES = ("student", "grader")
WEIGHTS = Path(__file__).parents[2] / "models/weights"
ROUNDS, BATCH, FRAMES = 7, 64, 64


def main() -> None:
    """Measure, and write the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    out = parser.parse_args().out
    images = _frames()
    figures: dict[str, Any] = {"units": has_bfloat16("cpu")}
    for name in JUDGES:
        judge = Grader.load(WEIGHTS / name)
        figures[name] = _training(judge) | _grading(judge, images)
        print(name, figures[name])
    where = environment("cpu")
    kind = torch.backends.cpu.get_cpu_capability()
    machine = f"{where['cpu']}, {kind}, one thread, torch {where['torch']}"
    about = {"what": "bfloat16 on a processor without units for it", "machine": machine}
    command = f"OMP_NUM_THREADS=1 python -m tests.benchmarks.bfloat16 {out}"
    head = {"schema": "racines.figures/1", "command": command, "source": "measured once"}
    write_json(out, head | about | figures)


def _frames() -> torch.Tensor:
    phantom = shared_phantom()
    targets = [phantom.target(view) for view in phantom.views]
    pose = Pose(*(torch.cat(parts) for parts in zip(*targets, strict=True)))
    rows = torch.arange(FRAMES) % len(targets)
    shift = torch.randn(FRAMES, 3, generator=torch.Generator().manual_seed(0)) * 0.004
    return phantom.render(
        Pose(pose.position[rows] + shift, pose.rotation[rows]), torch.arange(FRAMES)
    )


def _rates(ways: dict[str, Callable[[], object]], count: int) -> dict[str, float]:
    """Return images a second of each way, which takes `count` of them."""
    return {name: round(rate(count, took), 1) for name, took in in_turns(ways, ROUNDS).items()}


def _training(judge: Grader) -> dict[str, float]:
    """Return images a second in training, in float32 and in autocast."""
    size = judge.config.input_size
    images = torch.randn(BATCH, 1, size, size, generator=torch.Generator().manual_seed(0))

    def step(cast: bool) -> Callable[[], object]:
        network = judge.build(judge.config, len(judge.labels)).train()
        optimiser = torch.optim.AdamW(network.parameters(), fused=True)

        def work() -> None:
            with torch.autocast("cpu", torch.bfloat16, enabled=cast):
                logits, grades = network(images)
            optimiser.zero_grad()
            (logits.float().square().mean() + grades.float().square().mean()).backward()
            optimiser.step()

        return work

    return _rates({"train_float32": step(False), "train_bfloat16": step(True)}, BATCH)


def _grading(judge: Grader, images: torch.Tensor) -> dict[str, float]:
    """Return images a second by float32 sums and by oneDNN, and how far they lie apart."""
    said = {}

    def grade(units: bool) -> Callable[[], object]:
        def work() -> None:
            batching.has_bfloat16 = lambda _: units
            said[units] = judge.read(images)

        return work

    rates = _rates({"grade_sums": grade(False), "grade_onednn": grade(True)}, len(images))
    batching.has_bfloat16 = has_bfloat16
    own, theirs = (torch.softmax(each.logits / judge.temperature, -1) for each in said.values())
    return rates | {
        "probability_apart": float((own - theirs).abs().max()),
        "labels_apart": int((own.argmax(-1) != theirs.argmax(-1)).sum()),
        "grade_apart": float((said[True].grades - said[False].grades).abs().max()),
        "frames": len(images),
    }


if __name__ == "__main__":
    main()
