# pyright: strict
"""Normal numbers in double, for what is rounded or compared: equal on every processor."""

import math

import torch
from torch import Tensor

from racines_data.randomness import uniform


def exact_normal(seeds: Tensor, count: int, stream: int) -> Tensor:
    """Draw (B, count) standard normal float64 numbers from (B,) seeds (Box-Muller).

    Uniform hashes are exact; logarithm and cosine stray in the last bit of a double at most, which
    no rounding to float32 or to an integer is likely to show.
    """
    first, second = uniform(seeds, 2 * count, stream).double().chunk(2, dim=1)
    return (-2.0 * torch.log1p(-first)).sqrt() * torch.cos(2.0 * math.pi * second)
