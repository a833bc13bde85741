"""Counter-based random numbers: a sample's draw depends on its own seed, never on its batch.

A stateful generator gives a frame other noise when the batch around it changes. Here every number
is a hash of (seed, counter), so a frame drawn alone, in a batch, or by another worker is the same.
The hash is the finaliser of SplitMix64 (Steele et al., Fast Splittable Pseudorandom Number
Generators, 2014), in wrapping int64 arithmetic.
"""

import math

import torch
from torch import Tensor

_GOLDEN = -7046029254386353131  # 0x9E3779B97F4A7C15
_MIX_A = -4658895280553007687  # 0xBF58476D1CE4E5B9
_MIX_B = -7723592293110705685  # 0x94D049BB133111EB
_WRAP = 1 << 64


def _shift(x: Tensor, bits: int) -> Tensor:
    return (x >> bits) & ((1 << (64 - bits)) - 1)  # logical shift on a signed type


def mix(x: Tensor) -> Tensor:
    """Hash int64 values to int64 values."""
    x = (x ^ _shift(x, 30)) * _MIX_A
    x = (x ^ _shift(x, 27)) * _MIX_B
    return x ^ _shift(x, 31)


def derive(seed: Tensor, *keys: int | Tensor) -> Tensor:
    """Derive int64 seeds from (B,) seeds and keys (integers or tensors that broadcast)."""
    for key in keys:
        if isinstance(key, int):  # hashed as such: a dozen calls of the tensor library less
            seed = mix(seed * 3 + _hashed(key))
        else:
            seed = mix(seed * 3 + _GOLDEN + mix(torch.as_tensor(key, device=seed.device) + _GOLDEN))
    return seed


def _hashed(key: int) -> int:
    """Return `_GOLDEN + mix(key + _GOLDEN)` of an integer, in wrapping 64 bits."""
    x = (key + _GOLDEN) % _WRAP
    x = (x ^ (x >> 30)) * _MIX_A % _WRAP
    x = (x ^ (x >> 27)) * _MIX_B % _WRAP
    x = ((x ^ (x >> 31)) + _GOLDEN) % _WRAP
    return x - _WRAP if x >= _WRAP // 2 else x


def sample_seeds(seed: int | Tensor, count: int, device: torch.device | str = "cpu") -> Tensor:
    """Return (count,) int64 seeds: those given, or derived from one integer and the index."""
    if isinstance(seed, Tensor):
        return seed.to(device=device, dtype=torch.int64).expand(count)
    index = torch.arange(count, dtype=torch.int64, device=device)
    return derive(torch.full_like(index, seed), index)


def uniform(seeds: Tensor, count: int, stream: int = 0) -> Tensor:
    """Draw (B, count) uniform float32 numbers in [0, 1) from (B,) seeds."""
    counter = torch.arange(count, dtype=torch.int64, device=seeds.device)
    bits = mix(derive(seeds, stream).unsqueeze(-1) + counter * _GOLDEN)
    return _shift(bits, 40).to(torch.float32) * 2.0**-24


def normal(seeds: Tensor, count: int, stream: int = 0) -> Tensor:
    """Draw (B, count) standard normal float32 numbers from (B,) seeds (Box-Muller)."""
    half = (count + 1) // 2
    u = uniform(seeds, 2 * half, stream)
    radius = (-2.0 * torch.log1p(-u[..., :half])).sqrt()
    angle = (2.0 * math.pi) * u[..., half:]
    return torch.cat([radius * angle.cos(), radius * angle.sin()], -1)[..., :count]
