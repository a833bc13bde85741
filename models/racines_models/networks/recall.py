"""The network that looks back over an episode: what all images so far say together of one view.

    a token per image -> causal self-attention -> where the view is, as known by then
                                  └-> of any pose passed: how likely it shows the view

A servo reads each image for itself, and errs in neighbouring ones alike. Beside each other, with
the poses between them known, they tell more: where along the skin the ventricle is longest, and on
which side a rib lies. Attention is that of Vaswani et al., Attention Is All You Need (2017); poses
passed are judged as the targets of an attentive neural process (Kim et al., ICLR 2019).
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import one_hot, scaled_dot_product_attention

LIES = (0.02, 0.02, 0.02, 0.2, 0.2, 0.2)
"""Metres and radians that count as one in where poses lie, about a view's middle."""
SURE = (-4.0, 2.0)
"""Range of the logarithm of the deviations, in units of `LIES`."""
FEATURES = 320
"""Of an image, as the servo's network has them before its last layer."""
PARTS = {"lies": 6, "read": 6, "sureness": 6, "shown": 2, "features": FEATURES}
"""Numbers of a token: where the probe is and where the image says that the view is, in `LIES`;
logarithms of how sure it is; logits of how completely and how well it shows the view."""
TOKEN = sum(PARTS.values())
SECONDS = 100.0
"""Steps that count as one."""
SAID = 3
"""Logits of a pose passed: its completeness, a tenth of its grade, and that both make a hit."""
FIRST = -0.5
"""Logarithm of the deviation before anything is learned."""


class Recalled(NamedTuple):
    """What is known of B episodes after each of T images."""

    centre: Tensor
    """(B, T, 6) where the view lies, in `LIES`."""
    sureness: Tensor
    """(B, T, 6) logarithms of its deviations."""
    own: Tensor
    """(B, T, D) what each image says for itself."""
    known: Tensor
    """(B, T, D) what is known after it."""


class RecallNetwork(nn.Module):
    """Two layers of attention over the images of an episode; it owns its normalisation."""

    eyes: Tensor

    def __init__(self, views: int, width: int = 96, layers: int = 2, heads: int = 6) -> None:
        """Build for so many views."""
        super().__init__()
        self.views, self.heads = views, heads
        self.features = nn.Sequential(nn.LayerNorm(FEATURES), nn.Linear(FEATURES, width))
        self.numbers = nn.Linear(TOKEN - FEATURES + 6 + 1 + views, width)
        self.layers = nn.ModuleList(_Layer(width, heads) for _ in range(layers))
        self.norm = nn.LayerNorm(width)
        last = nn.Linear(width, 12)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.where = nn.Sequential(nn.Linear(width + 12, width), nn.GELU(), last)
        self.ask = nn.Sequential(
            nn.Linear(2 * width + 18 + views, 2 * width), nn.GELU(), nn.Linear(2 * width, width)
        )
        self.query, self.keys = nn.Linear(width, width), nn.Linear(width, 2 * width)
        self.nearness = nn.Parameter(torch.arange(heads).float())
        """Logarithms of how much less a frame counts by the square of its distance, by head."""
        self.judge = nn.Sequential(
            nn.LayerNorm(2 * width), nn.Linear(2 * width, width), nn.GELU(), nn.Linear(width, SAID)
        )
        self.register_buffer("eyes", torch.zeros(32, dtype=torch.uint8))
        """SHA-256 of the weights of the servo whose features these are."""

    def forward(self, tokens: Tensor, seen: Tensor, labels: Tensor) -> Recalled:
        """Look back from each of T images.

        Args:
            tokens: (B, T, TOKEN).
            seen: (B, T) bool, which of them there are; the first is.
            labels: (B,) of the views that are looked for.
        """
        lies, read, sureness, shown, features = tokens.split(list(PARTS.values()), -1)
        count, length, _ = tokens.shape
        # What the readings so far come to, each by how sure it is, beside one that says 0.
        weight = (-2.0 * sureness).exp() * seen.unsqueeze(-1)
        mean = (weight * read).cumsum(1) / (weight.cumsum(1) + 1.0)
        when = torch.arange(length, device=tokens.device) / SECONDS
        goal = one_hot(labels, self.views).float()
        beside = [when.view(1, -1, 1).expand(count, -1, 1), goal[:, None].expand(-1, length, -1)]
        numbers = torch.cat([lies, read, read - mean, sureness, shown, *beside], -1)
        own = self.numbers(numbers) + self.features(features)
        earlier = torch.ones(length, length, dtype=torch.bool, device=tokens.device).tril()
        alone = torch.eye(length, dtype=torch.bool, device=tokens.device)
        allowed = (earlier & seen.unsqueeze(1) | alone).unsqueeze(1)
        known = own
        for layer in self.layers:
            known = layer(known, allowed)
        known = self.norm(known)
        said = self.where(torch.cat([known, mean, lies], -1))
        return Recalled(mean + said[..., :6], (said[..., 6:] + FIRST).clamp(*SURE), own, known)

    def score(
        self, tokens: Tensor, seen: Tensor, labels: Tensor, recalled: Recalled, which: Tensor,
        by: Tensor,
    ) -> Tensor:  # fmt: skip
        """Return (B, K, SAID) logits of K poses passed, by what was known at K moments.

        Args:
            tokens: as of `forward`, as are `seen` and `labels`.
            seen: which there are.
            labels: what is looked for.
            recalled: what `forward` returned.
            which: (B, K) int64, images whose poses are judged.
            by: (B, K) int64, the last image that is known.
        """
        row = torch.arange(len(tokens), device=tokens.device).unsqueeze(1)
        lies = tokens[..., :6]
        pose = lies[row, which]
        centre, sureness = (each[row, by].detach() for each in recalled[:2])
        goal = one_hot(labels, self.views).float().unsqueeze(1).expand(-1, which.shape[1], -1)
        asked = [pose, pose - centre, sureness, goal]
        query = self.ask(torch.cat([*asked, recalled.own[row, which], recalled.known[row, by]], -1))
        keys, values = self.keys(recalled.known).chunk(2, -1)
        away = (pose.unsqueeze(2) - lies.unsqueeze(1)).square().sum(-1)
        bias = -away.unsqueeze(1) * self.nearness.exp().view(1, -1, 1, 1)
        moment = torch.arange(tokens.shape[1], device=tokens.device)
        allowed = (moment <= by.unsqueeze(-1)) & seen.unsqueeze(1)
        bias = bias.masked_fill(~allowed.unsqueeze(1), -1e9)
        parts = [_split(each, self.heads) for each in (self.query(query), keys, values)]
        found = _join(scaled_dot_product_attention(*parts, attn_mask=bias))
        return self.judge(torch.cat([query, found], -1))

    def recall(self, tokens: Tensor, seen: Tensor, labels: Tensor) -> tuple[Tensor, Tensor]:
        """Return (B, 6) where the view lies by all that was seen, and (B, T) logits of hits."""
        recalled = self(tokens, seen, labels)
        row = torch.arange(len(tokens), device=tokens.device)
        last = seen.sum(1) - 1
        every = torch.arange(tokens.shape[1], device=tokens.device).expand(len(tokens), -1)
        by = last.unsqueeze(1).expand_as(every)
        said = self.score(tokens, seen, labels, recalled, every, by)[..., -1]
        return recalled.centre[row, last], said.masked_fill(~seen, -torch.inf)


class _Layer(nn.Module):
    """Attention and two dense layers, each beside a shortcut and after a normalisation."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.before, self.between = nn.LayerNorm(width), nn.LayerNorm(width)
        self.inward, self.outward = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.dense = nn.Sequential(
            nn.Linear(width, 2 * width), nn.GELU(), nn.Linear(2 * width, width)
        )

    def forward(self, x: Tensor, allowed: Tensor) -> Tensor:
        parts = [_split(part, self.heads) for part in self.inward(self.before(x)).chunk(3, -1)]
        x = x + self.outward(_join(scaled_dot_product_attention(*parts, attn_mask=allowed)))
        return x + self.dense(self.between(x))


def _split(x: Tensor, heads: int) -> Tensor:
    """Return (B, heads, T, D / heads) of (B, T, D)."""
    return x.view(*x.shape[:2], heads, -1).transpose(1, 2)


def _join(x: Tensor) -> Tensor:
    """Undo `_split`."""
    return x.transpose(1, 2).flatten(2)
