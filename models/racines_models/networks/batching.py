"""Batches of one fixed size, so that a sample's image ignores its neighbours to the last bit."""

from collections.abc import Callable

import torch
from torch import Tensor

SIZE = {"cpu": 8, "cuda": 256}
"""Samples per call by device type. Eight is also the fastest on a CPU, whose caches it fits."""


def in_fixed_batches(draw: Callable[..., Tensor], *inputs: Tensor) -> Tensor:
    """Apply `draw` to (B, …) inputs in batches of one size, the last one padded.

    Matrix products and convolutions round differently at different batch sizes, by 1e-9 here:
    enough to flip a gray level now and then.
    """
    count = len(inputs[0])
    size = SIZE.get(inputs[0].device.type, 256)
    short = -count % size if count else size
    padded = [torch.cat([x, x.new_ones(1).expand(short, *x.shape[1:])]) for x in inputs]
    chunks = zip(*(x.split(size) for x in padded), strict=True)
    return torch.cat([draw(*chunk) for chunk in chunks])[:count]
