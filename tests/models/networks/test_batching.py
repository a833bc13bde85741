"""Bfloat16 on processors without units for it: sums by float32 kernels, rounded as theirs are."""

import pytest
import torch
from torch import Tensor, nn
from torch.utils._python_dispatch import TorchDispatchMode

from racines_models.networks import batching
from racines_models.networks.batching import Lasting, in_fixed_batches

ULP = 2.0**-7
"""Of bfloat16, relative: two sums that round to neighbours lie so far apart."""


@pytest.fixture
def network() -> nn.Module:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return nn.Sequential(
            nn.Conv2d(1, 8, 3, 2, 1), nn.ReLU(), nn.Conv2d(8, 8, 3, padding=1, groups=2)
        )


@pytest.fixture
def images() -> Tensor:
    return torch.randn(11, 1, 32, 32, generator=torch.Generator().manual_seed(1))


@pytest.fixture(params=[True, False], ids=["autocast", "weights"])
def answer(request, network, monkeypatch):
    """Ask a network in bfloat16, on a processor with or without units for it."""
    cast = request.param
    asked = network if cast else network.to(torch.bfloat16)

    def answered(images: Tensor, units: bool) -> Tensor:
        monkeypatch.setattr(batching, "has_bfloat16", lambda _: units)

        def layer(batch: Tensor) -> Tensor:
            with torch.autocast("cpu", torch.bfloat16, enabled=cast):
                return asked(batch if cast else batch.to(torch.bfloat16))

        with torch.no_grad():
            return in_fixed_batches(layer, images)

    return answered


def test_float32_sums_round_as_bfloat16_units_do(answer, images):
    own, theirs = answer(images, units=False), answer(images, units=True)
    assert own.dtype == theirs.dtype == torch.bfloat16
    apart = (own.float() - theirs.float()).abs() / theirs.float().abs().clamp_min(0.1)
    assert apart.max() <= 2 * ULP  # one layer's neighbours, summed up by the next
    assert (own == theirs).float().mean() > 0.99


def test_rows_ignore_their_batch_without_units_too(answer, images):
    whole = answer(images, units=False)
    alone = torch.cat([answer(images[row : row + 1], units=False) for row in range(len(images))])
    assert torch.equal(whole, alone)


def test_float32_stays_float32(network, images, monkeypatch):
    monkeypatch.setattr(batching, "has_bfloat16", lambda _: False)
    with torch.no_grad():
        assert torch.equal(in_fixed_batches(network, images[:8]), network(images[:8]))


class Convolutions(TorchDispatchMode):
    """Notes the types in which kernels convolve."""

    def __init__(self) -> None:
        super().__init__()
        self.types: set[torch.dtype] = set()

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        if func is torch.ops.aten.convolution.default:
            self.types.add(args[0].dtype)
        return func(*args, **(kwargs or {}))


@pytest.mark.parametrize(("units", "kind"), [(False, torch.float32), (True, torch.bfloat16)])
def test_kernels_are_those_that_the_processor_has_units_for(answer, images, units, kind):
    with Convolutions() as seen:
        answer(images, units=units)
    assert seen.types == {kind}


def test_images_that_last_are_not_looked_at_again(network, images):
    looked, lasting = [], Lasting()

    def look(part: Tensor) -> Tensor:
        looked.append(len(part))
        return network(part).flatten(1)

    with torch.no_grad():
        for changed in ([], [3], list(range(9)), []):
            images = images.clone()
            images[changed] += 1.0
            assert torch.equal(lasting(look, images), in_fixed_batches(network, images).flatten(1))
        images[2, 0, 5, 5] -= 1.0  # in place, a pixel
        said = lasting(look, images)
        assert torch.equal(said, in_fixed_batches(network, images).flatten(1))
        few = lasting(look, images[:4])
    assert looked == [8] * (2 + 0 + 1 + 2 + 0 + 1 + 1), "chunks of eight, of what is new alone"
    assert torch.equal(few, said[:4])
