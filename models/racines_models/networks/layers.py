"""What generators and discriminators are built of: sizes, initial weights, condition, attention."""

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn
from torch.nn.functional import max_pool2d

from racines_data.errors import RacinesError
from racines_data.geometry import parameters_to_pose, rotation_6d
from racines_data.imaging import IMAGE_SIZE

LEVELS = 5
"""Halvings from 128 to 4."""
BOTTOM = IMAGE_SIZE >> LEVELS
INJECTIONS = ("concat", "norm")
"""Where the condition enters a generator: at its input only, or in every normalisation."""
ATTENTION_SIZE = 32
"""Side of the maps that attend: the finest that a CPU affords, with 1,024 places."""
POOL = 4
MODES = {"continuous": 15, "euler": 12}
"""Width of the condition vector in each mode of `Conditioning`."""


def widths(width: int) -> list[int]:
    """Return the channels after each halving: doubling thrice, then level."""
    return [width * min(1 << level, 8) for level in range(LEVELS)]


def bottom_features(width: int) -> int:
    """Return the entries of the flattened 4×4 map."""
    return widths(width)[-1] * BOTTOM * BOTTOM


def initialise(module: nn.Module) -> None:
    """Draw weights as DCGAN does: N(0, 0.02), batch-norm scales N(1, 0.02).

    Source: Radford et al., Unsupervised Representation Learning with Deep Convolutional
    Generative Adversarial Networks, 2016, section 4.
    """
    if isinstance(module, nn.Conv2d | nn.ConvTranspose2d | nn.Linear):
        nn.init.normal_(module.weight, 0.0, 0.02)
        if module.bias is not None:
            nn.init.zeros_(module.bias)
    elif isinstance(module, nn.BatchNorm1d | nn.BatchNorm2d) and module.affine:
        nn.init.normal_(module.weight, 1.0, 0.02)
        nn.init.zeros_(module.bias)


@contextmanager
def frozen(net: nn.Module) -> Iterator[None]:
    """Let gradients pass through a network without computing those of its weights."""
    net.requires_grad_(False)
    try:
        yield
    finally:
        net.requires_grad_(True)


def check_injection(injection: str, name: str) -> None:
    """Refuse an injection that is none, in the config of a name."""
    if injection not in INJECTIONS:
        raise RacinesError(f"{name}.injection: {injection!r}: use {' or '.join(INJECTIONS)}")


def on_circle(phase: Tensor) -> Tensor:
    """Return (…, 2 K) sines and cosines of (…, K) phases in [0, 1): the end is the start."""
    turn = 2.0 * math.pi * phase
    return torch.cat([turn.sin(), turn.cos()], -1)


class Conditioning(nn.Module):
    """Normalises (B, 12) parameters to a condition vector.

    `continuous`: position (3), 6-D rotation (6), force and torque (6). `euler`: the twelve columns
    as they are, which jump where rotation_x passes ±π (the paper's conditioning, kept as an
    ablation). Each entry is standardised with the mean and deviation of the training frames; an
    absent force (NaN) becomes 0, the training mean. A `phased` one takes (B, 13) parameters, and
    adds sine and cosine of the beat's phase, the last of them.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, mode: str = "continuous", phased: bool = False):
        super().__init__()
        if mode not in MODES:
            raise RacinesError(f"conditioning {mode!r} is unknown: choose {' or '.join(MODES)}")
        self.mode, self.phased = mode, phased
        self.width = MODES[mode] + 2 * phased
        self.register_buffer("mean", torch.zeros(self.width))
        self.register_buffer("std", torch.ones(self.width))

    def encode(self, parameters: Tensor) -> Tensor:
        """Return the (B, width) condition before standardisation, NaN where a force is absent."""
        beat = [on_circle(parameters[..., 12:])] if self.phased else []
        if self.mode == "euler":
            return torch.cat([parameters[..., :12], *beat], -1) if beat else parameters
        pose = parameters_to_pose(parameters)
        parts = [pose.position, rotation_6d(pose.rotation), parameters[..., :6], *beat]
        return torch.cat(parts, -1)

    def fit(self, parameters: Tensor) -> "Conditioning":
        """Take mean and deviation from (N, 12) training parameters; without spread, 1.

        (N, 13) where it is phased.
        """
        raw = self.encode(parameters.double())
        known = torch.isfinite(raw)
        count = known.sum(0).clamp_min(1)
        mean = raw.where(known, 0.0).sum(0) / count
        std = ((raw - mean).where(known, 0.0).square().sum(0) / count).sqrt()
        self.mean.copy_(mean)
        self.std.copy_(std.where(std > 1e-6, 1.0))
        return self

    def forward(self, parameters: Tensor) -> Tensor:
        """Return the (B, width) float32 standardised condition of (B, 12) parameters."""
        return torch.nan_to_num((self.encode(parameters) - self.mean) / self.std, nan=0.0)


class ConditionalBatchNorm(nn.Module):
    """Batch norm whose scale and shift are linear in an embedding of the condition.

    `embedding` 0 makes it a plain batch norm, with scale and shift of its own. Maps may be
    (B, C, H, W), or (B, C) after a dense layer.

    Source: de Vries et al., Modulating Early Visual Processing by Language, 2017, section 3; the
    same per-channel scale and shift as FiLM (Perez et al., 2018).
    """

    def __init__(self, channels: int, embedding: int = 0, flat: bool = False):
        super().__init__()
        kind = nn.BatchNorm1d if flat else nn.BatchNorm2d
        self.norm = kind(channels, affine=not embedding)
        self.affine = nn.Linear(embedding, 2 * channels) if embedding else None
        if self.affine is not None:
            initialise(self.affine)

    def forward(self, maps: Tensor, embedded: Tensor | None) -> Tensor:
        """Return normalised maps; (B, embedding) is used only if the layer has one."""
        maps = self.norm(maps)
        if self.affine is None:
            return maps
        affine = self.affine(embedded).to(maps.dtype)
        scale, shift = affine.view(*affine.shape, *(1,) * (maps.dim() - 2)).chunk(2, 1)
        return torch.addcmul(shift, maps, 1.0 + scale)


class ConditionEmbedding(nn.Sequential):
    """(B, condition) to (B, width): two dense layers, shared by all that use the embedding."""

    def __init__(self, condition: int, width: int, batch_norm: bool = False):
        layers: list[nn.Module] = []
        for inputs in (condition, width):
            layers += [nn.Linear(inputs, width)]
            layers += [nn.BatchNorm1d(width)] if batch_norm else []
            layers += [nn.LeakyReLU(0.2)]
        super().__init__(*layers)


class SelfAttention(nn.Module):
    """Each place gathers from all others; a learned gain that starts at 0 adds it to the map.

    Keys and values are pooled 4×4, queries and keys have an eighth of the channels (at least 8).

    Source: Zhang et al., Self-Attention Generative Adversarial Networks, 2019, section 3.
    """

    def __init__(self, channels: int):
        super().__init__()
        inner, outer = max(channels // 8, 8), max(channels // 2, 8)
        self.query = nn.Conv2d(channels, inner, 1, bias=False)
        self.key = nn.Conv2d(channels, inner, 1, bias=False)
        self.value = nn.Conv2d(channels, outer, 1, bias=False)
        self.out = nn.Conv2d(outer, channels, 1, bias=False)
        self.gain = nn.Parameter(torch.zeros(()))

    def forward(self, maps: Tensor) -> Tensor:
        """Return (B, C, H, W) maps with what each place gathered."""
        query = self.query(maps).flatten(2).transpose(1, 2)
        key = max_pool2d(self.key(maps), POOL).flatten(2)
        value = max_pool2d(self.value(maps), POOL).flatten(2).transpose(1, 2)
        # Plainly written: fused attention has no second derivative, which R1 needs.
        gathered = (query @ key).softmax(-1).to(value.dtype) @ value
        gathered = gathered.transpose(1, 2).unflatten(2, maps.shape[2:])
        return maps + self.gain.to(maps.dtype) * self.out(gathered)


def attending(sides: Iterable[int], channels: Iterable[int]) -> nn.ModuleDict:
    """Return self-attention by level, where the level's maps have a side of 32."""
    levels = enumerate(zip(sides, channels, strict=True))
    return nn.ModuleDict(
        {str(level): SelfAttention(n) for level, (side, n) in levels if side == ATTENTION_SIZE}
    )


def through(
    blocks: nn.ModuleList, attention: nn.ModuleDict, maps: Tensor, embedded: Tensor | None
) -> Tensor:
    """Return maps after all blocks, each followed by the self-attention of its level, if any."""
    for level, block in enumerate(blocks):
        maps = block(maps, embedded)
        if str(level) in attention:
            maps = attention[str(level)](maps)
    return maps
