"""Rows ignore their batch: published weights, images, judgements and steps.

The published networks have the widths that reach the libraries' blocked code; the narrow layers of
`TestDense` reach the code for what is left over.
"""

from pathlib import Path

import pytest
import torch
from torch import Tensor, nn
from torch.nn.functional import linear

from racines_data.phantom.config import PhantomConfig
from racines_data.phantom.model import shared_phantom
from racines_envs.worlds.making import make_core
from racines_models.judges.grader.model import Grader
from racines_models.judges.pose.regressor import PoseRegressor
from racines_models.networks.batching import SIZE, in_fixed_batches
from racines_models.registry import load_generator
from racines_models.scores.features import InceptionFeatures
from racines_models.testing import check_rows
from tests.models.conftest import pictures, random_parameters

pytestmark = pytest.mark.contract
WEIGHTS = Path(__file__).parents[2] / "models/weights"
GENERATORS = [
    "vae-gan",
    "cgan",
    "attention-cgan",
    "residual-cgan",
    "stylegan",
    "flow",
    "scene-field",
]
POSES = random_parameters(11, seed=3)
SEEDS = torch.arange(11) * 7 + 1


@pytest.mark.parametrize("name", GENERATORS)
def test_a_drawn_image_ignores_its_batch(name: str) -> None:
    generator = load_generator(name, WEIGHTS / name)
    if name == "flow":
        generator = generator.with_steps(2, "euler")  # pyright: ignore[reportAttributeAccessIssue]
    check_rows(generator.generate, POSES, SEEDS)


@pytest.mark.parametrize("name", ["grader", "student"])
def test_a_grade_ignores_its_batch(name: str) -> None:
    check_rows(Grader.load(WEIGHTS / name).read, pictures(POSES))


@pytest.mark.parametrize("name", ["pose", "encoder"])
def test_a_pose_ignores_its_batch(name: str) -> None:
    check_rows(PoseRegressor.load(WEIGHTS / name).predict, pictures(POSES))


@pytest.mark.parametrize("anatomy", ["heart", "abdomen"])
def test_a_scan_ignores_its_batch(anatomy: str) -> None:
    check_rows(shared_phantom(PhantomConfig(anatomy=anatomy)).generate, POSES, SEEDS)


def test_inception_features_ignore_their_batch() -> None:
    """Few of the cases, for the network is large: of nine, the last is alone in its chunk."""
    extractor, images = InceptionFeatures(), pictures(POSES[: SIZE["cpu"] + 1])
    assert torch.equal(extractor(images.roll(3, 0)), extractor(images).roll(3, 0))


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
@pytest.mark.parametrize("sizes", [(15, 6), (6, 6), (6, 5), (115, 9), (64, 33), (512, 5)])
class TestDense:
    """Widths at which MKL's products do differ by place."""

    def test_a_dense_layer_ignores_its_batch(
        self, sizes: tuple[int, int], dtype: torch.dtype
    ) -> None:
        layer, rows = self.make(sizes)

        def apply(x: Tensor) -> Tensor:
            with torch.autocast("cpu", dtype, enabled=dtype == torch.bfloat16):
                return layer(x)

        with torch.inference_mode():
            check_rows(lambda x: in_fixed_batches(apply, x), rows)

    def test_it_is_still_the_layer(self, sizes: tuple[int, int], dtype: torch.dtype) -> None:
        layer, rows = self.make(sizes)
        layer, rows = layer.to(dtype), rows.to(dtype)
        for x in (rows, rows[:, None].expand(-1, 3, -1)):
            got = in_fixed_batches(layer, x)
            exact = linear(x.double(), layer.weight.double(), layer.bias.double())
            assert got.dtype == dtype  # rounded once: PyTorch may round before the bias, too
            torch.testing.assert_close(got, exact.to(dtype))

    def make(self, sizes: tuple[int, int]) -> tuple[nn.Linear, Tensor]:
        torch.manual_seed(0)
        return nn.Linear(*sizes), torch.randn(11, sizes[0])


def test_a_step_ignores_its_batch() -> None:
    """Observation, reward and judgement of one environment alone are those among nine."""
    phantom, seeds = shared_phantom(), torch.arange(9) + 5
    found = []
    for count in (9, 1):
        core = make_core(
            "SC", count, observation="multimodal", grader=WEIGHTS / "student", phantom=phantom
        )
        seen = core.reset(seeds[-count:])
        step = core.step(torch.full((count,), 3))
        found.append([*seen.values(), *step.observation.values(), step.reward])
    for among, alone in zip(*found, strict=True):
        assert torch.equal(among[-1:], alone)
