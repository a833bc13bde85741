"""Self-attention over the places of a feature map."""

import torch
from torch import Tensor, nn
from torch.nn.functional import max_pool2d

POOL = 4


class SelfAttention(nn.Module):
    """Each place gathers from all others; a learned gain that starts at 0 adds it to the map.

    Keys and values are pooled 2×2, queries and keys have an eighth of the channels (at least 8).

    Source: Zhang et al., Self-Attention Generative Adversarial Networks, 2019, section 3.
    """

    def __init__(self, channels: int):
        super().__init__()
        self.inner = max(channels // 8, 8)
        self.query = nn.Conv2d(channels, self.inner, 1, bias=False)
        self.key = nn.Conv2d(channels, self.inner, 1, bias=False)
        self.value = nn.Conv2d(channels, max(channels // 2, 8), 1, bias=False)
        self.out = nn.Conv2d(max(channels // 2, 8), channels, 1, bias=False)
        self.gain = nn.Parameter(torch.zeros(()))

    def forward(self, maps: Tensor) -> Tensor:
        """Return (B, C, H, W) maps with what each place gathered."""
        query = self.query(maps).flatten(2).transpose(1, 2)
        key = max_pool2d(self.key(maps), POOL).flatten(2).transpose(1, 2)
        value = max_pool2d(self.value(maps), POOL).flatten(2).transpose(1, 2)
        # Plainly written: fused attention has no second derivative, which R1 needs.
        gathered = (query @ key.transpose(1, 2)).softmax(-1).to(value.dtype) @ value
        gathered = gathered.transpose(1, 2).unflatten(2, maps.shape[2:])
        return maps + self.gain.to(maps.dtype) * self.out(gathered)
