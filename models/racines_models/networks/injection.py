"""Where the condition enters a generator: at its input only, or in every normalisation."""

import torch
from torch import Tensor, nn

from racines_data.errors import RacinesError

INJECTIONS = ("concat", "norm")


def check_injection(injection: str, name: str) -> None:
    """Refuse an injection that is none.

    Raises:
        RacinesError: it is neither `concat` nor `norm`.
    """
    if injection not in INJECTIONS:
        raise RacinesError(f"{name}.injection: {injection!r}: use {' or '.join(INJECTIONS)}")


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
            nn.init.normal_(self.affine.weight, 0.0, 0.02)
            nn.init.zeros_(self.affine.bias)

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
