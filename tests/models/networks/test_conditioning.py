"""The condition vector: continuous where Euler angles jump, standardised, calm about no force."""

import math

import pytest
import torch

from racines_data.errors import RacinesError
from racines_models.networks.layers import Conditioning
from tests.models.conftest import random_parameters


def across_pi() -> torch.Tensor:
    """Two poses a thousandth of a radian apart, either side of rotation_x = π."""
    pair = random_parameters(1, 0).repeat(2, 1)
    pair[:, 9] = torch.tensor([math.pi - 5e-4, -math.pi + 5e-4])
    return pair


def test_continuous_where_euler_jumps():
    train = random_parameters(500, 1)
    gaps = {}
    for mode in ("continuous", "euler"):
        a, b = Conditioning(mode).fit(train)(across_pi())
        gaps[mode] = float((a - b).abs().max())
    assert gaps["continuous"] < 0.01
    assert gaps["euler"] > 1.0


@pytest.mark.parametrize(("mode", "width"), [("continuous", 15), ("euler", 12)])
def test_standardised_on_train(mode, width):
    train = random_parameters(500, 1)
    condition = Conditioning(mode).fit(train)(train)
    assert condition.shape == (500, width) and condition.dtype == torch.float32
    torch.testing.assert_close(condition.mean(0), torch.zeros(width), atol=1e-4, rtol=0)
    torch.testing.assert_close(condition.std(0), torch.ones(width), atol=1e-2, rtol=0)


@pytest.mark.parametrize("mode", ["continuous", "euler"])
def test_absent_force_is_the_mean(mode):
    train = random_parameters(100, 1)
    absent = train.clone()
    absent[::2, :6] = math.nan
    conditioning = Conditioning(mode).fit(absent)
    condition = conditioning(absent[:1])
    forces = condition[0, -6:] if mode == "continuous" else condition[0, :6]
    assert forces.eq(0).all()
    reference = Conditioning(mode).fit(train[1::2])
    width = conditioning.width
    force = slice(width - 6, width) if mode == "continuous" else slice(0, 6)
    torch.testing.assert_close(conditioning.mean[force], reference.mean[force])


def test_data_without_any_force_or_spread():
    train = random_parameters(20, 1)
    train[:, :6] = math.nan
    train[:, 6] = 0.5
    condition = Conditioning().fit(train)(train)
    assert condition.isfinite().all()
    assert condition[:, 0].abs().max() < 1e-6 and condition[:, -6:].eq(0).all()


def test_statistics_travel_with_the_weights():
    fitted = Conditioning().fit(random_parameters(50, 1))
    other = Conditioning()
    other.load_state_dict(fitted.state_dict())
    assert torch.equal(other(random_parameters(5, 2)), fitted(random_parameters(5, 2)))


def test_unknown_mode_is_refused():
    with pytest.raises(RacinesError, match="continuous or euler"):
        Conditioning("quaternion")
