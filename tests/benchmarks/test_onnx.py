"""Speed of a generator as an ONNX file, beside the same network in eager PyTorch.

Both on one thread, as the file is run for the boards; with the published weights. Images may differ
by one gray level, where a sum rounds otherwise.
"""

from pathlib import Path

import pytest
import torch

from racines_data.geometry import pose_to_parameters
from racines_data.randomness import sample_seeds
from racines_models.exchange.onnx import OnnxGenerator, export_generator
from racines_models.registry import open_generator
from tests.benchmarks.lines import line_of
from tests.benchmarks.test_render import poses
from tests.benchmarks.turns import in_turns
from tests.conftest import ROOT

ROUNDS = 5
EAGER = "PyTorch, eager"


@pytest.mark.timeout(300)
@pytest.mark.slow
@pytest.mark.parametrize("count", [64, 1], ids=["batch of 64", "one at a time"])
def test_vae_gan_as_a_file(benchmark, line, tmp_path: Path, count: int) -> None:
    eager = open_generator("vae-gan", ROOT / "models/weights/vae-gan")
    export_generator(eager, tmp_path / "vae-gan.onnx")
    exported = OnnxGenerator(tmp_path / "vae-gan.onnx")
    parameters = pose_to_parameters(poses(count)).to(torch.float32)
    seeds, threads = sample_seeds(0, count), torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        images = [each.generate(parameters, seeds).int() for each in (exported, eager)]
        assert (images[0] - images[1]).abs().max() <= 1
        sides = {
            "ours": lambda: exported.generate(parameters, seeds),
            EAGER: lambda: eager.generate(parameters, seeds),
        }
        times = in_turns(sides, ROUNDS)
        benchmark.pedantic(sides["ours"], rounds=ROUNDS)
    finally:
        torch.set_num_threads(threads)
    work = f"vae-gan as an ONNX file, {count} a call, one thread"
    line(line_of(work, "images/s", count, times, EAGER, "images, within one gray level"))
