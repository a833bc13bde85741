"""Speed of the renderer: frames a second on this machine, batches of 64."""

import torch

from racines_data.geometry import Pose
from racines_data.phantom import shared_phantom
from racines_data.randomness import sample_seeds
from racines_data.views import VIEWS


def test_render_batch_of_64(benchmark) -> None:
    phantom = shared_phantom()
    poses = [phantom.target(VIEWS[i % 5]) for i in range(64)]
    pose = Pose(torch.cat([p.position for p in poses]), torch.cat([p.rotation for p in poses]))
    seeds = sample_seeds(0, 64)
    images = benchmark(phantom.render, pose, seeds)
    if benchmark.stats is not None:  # none where pytest-xdist switches measuring off
        benchmark.extra_info["frames_per_second"] = 64 / benchmark.stats.stats.median
    assert images.shape == (64, 128, 128)
