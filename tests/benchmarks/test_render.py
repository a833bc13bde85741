"""Speed of the renderer beside two published simulators, on the same poses of the same block.

The images cannot be equal: the models of sound are others. What is: the block's tissues, the poses,
and the pixels or rays under them. Ours draws more than they do (compounding, a beam's thickness,
side lobes, coupling, contact), they draw what their papers say; see `peers`.
"""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from racines_data.geometry import Pose
from racines_data.phantom import shared_phantom
from racines_data.phantom.acoustics import sector_mask
from racines_data.randomness import normal, sample_seeds
from racines_data.views import VIEWS
from tests.benchmarks.lines import line_of
from tests.benchmarks.peers.convolution import Convolution
from tests.benchmarks.peers.rays import Rays
from tests.benchmarks.peers.slices import AIR, LabelVolume
from tests.benchmarks.turns import in_turns

BATCH, ROUNDS = 64, 7
EQUAL = "poses, tissues and pixels or rays under them (models of sound differ)"
SONOGYM, LOTUS = "SonoGym's convolution, written again", "LOTUS's rays, written again"


@pytest.fixture(scope="module")
def volume() -> LabelVolume:
    return LabelVolume()


def poses(count: int) -> Pose:
    """Return poses about those of the five views, a centimetre off."""
    phantom = shared_phantom()
    each = [phantom.target(VIEWS[i % 5]) for i in range(count)]
    off = normal(sample_seeds(3, count), 3) * 0.005
    return Pose(torch.cat([p.position for p in each]) + off, torch.cat([p.rotation for p in each]))


@pytest.mark.timeout(300)
@pytest.mark.slow
@pytest.mark.parametrize("count", [BATCH, 1], ids=["batch of 64", "one at a time"])
def test_render(benchmark, line, volume: LabelVolume, count: int) -> None:
    phantom, pose, seeds = shared_phantom(), poses(count), sample_seeds(0, count)
    convolution, rays = Convolution(volume), Rays(volume)
    generator = torch.Generator().manual_seed(0)
    sides: dict[str, Callable[[], Tensor]] = {
        "ours": lambda: phantom.render(pose, seeds),
        SONOGYM: lambda: convolution.render(pose),
        LOTUS: lambda: rays.render(pose, generator),
    }
    assert_same_slices(volume, pose)
    for draw in sides.values():
        assert_shows_the_block(draw(), volume, pose)
    times = in_turns(sides, ROUNDS if count > 1 else 5 * ROUNDS, warm=2)
    benchmark.pedantic(sides["ours"], rounds=ROUNDS)
    work = "render, 128 × 128, " + ("64 poses" if count > 1 else "one pose")
    for peer, aim in ((SONOGYM, 3.0 if count > 1 else None), (LOTUS, None)):
        line(line_of(work, "frames/s", count, times, peer, EQUAL, aim))


def assert_same_slices(volume: LabelVolume, pose: Pose) -> None:
    """Check that the voxels under the pixels are the tissues that the anatomy has there."""
    found = volume.flat[volume.index(pose, volume.pixels)]
    points = volume.points(pose, volume.pixels)
    inside = found != AIR
    right = (found - 1)[inside] == volume.paint(points[inside])
    assert right.float().mean() > 0.97, "voxels are a millimetre wide: only borders may differ"


def assert_shows_the_block(images: Tensor, volume: LabelVolume, pose: Pose) -> None:
    """Check that a simulator draws blood darker than muscle, of every pose."""
    names = [tissue.name for tissue in volume.anatomy.tissues]
    labels = volume.flat[volume.index(pose, volume.pixels)] - 1
    labels[:, ~sector_mask(volume.config.probe)] = -1
    assert images.dtype == torch.uint8 and images.shape == labels.shape
    blood, muscle = (
        images[labels == names.index(n)].float().mean() for n in ("blood", "myocardium")
    )
    assert muscle > 1.5 * blood
