"""How good an attribution is: deletion and insertion, random maps, and overlap with regions."""

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from racines_data.randomness import normal, sample_seeds
from racines_envs.explain.maps import Explained, outputs

POINTS = 24
"""Images of a curve, the first and the last included."""
BLUR = 5.0
"""Standard deviation of the blur that insertion starts from, pixels."""
SMOOTH = 4.0
"""Standard deviation of the blur of the smooth random maps, pixels."""
TOP = 0.1
"""Share of the sector's pixels that count as the top of a map."""
_STREAM = 211


def blur(images: Tensor, sigma: float) -> Tensor:
    """Blur (N, H, W) float images by a Gaussian."""
    radius = int(3 * sigma + 0.5)
    offset = torch.arange(-radius, radius + 1, device=images.device)
    kernel = torch.exp(-0.5 * (offset / sigma) ** 2)
    kernel = kernel / kernel.sum()
    padded = functional.pad(images.unsqueeze(1), [radius] * 4, mode="replicate")
    across = functional.conv2d(padded, kernel.view(1, 1, 1, -1))
    return functional.conv2d(across, kernel.view(1, 1, -1, 1)).squeeze(1)


def random_maps(shape: torch.Size, seed: int, sigma: float = 0.0) -> Tensor:
    """Draw (N, H, W) maps of noise, blurred by `sigma` pixels: as ragged or smooth as wanted."""
    seeds = sample_seeds(seed, shape[0])
    noise = normal(seeds, shape[1] * shape[2], _STREAM).view(shape)
    return blur(noise, sigma) if sigma else noise


def ranks(maps: Tensor, sector: Tensor) -> Tensor:
    """Return the (N, H, W) order of the pixels in 0-1, the most important first; 2 outside.

    Pixels outside the (H, W) sector are black in every image and never taken.
    """
    order = maps[:, sector].argsort(dim=1, descending=True, stable=True)
    place = torch.full_like(maps, 2.0, dtype=torch.float32)
    place[:, sector] = order.argsort(dim=1).float() / order.shape[1]
    return place


def areas(
    judge: Explained, images: Tensor, params: Tensor, targets: Tensor, maps: Tensor, sector: Tensor,
    insert: bool, logits: bool,
) -> np.ndarray:  # fmt: skip
    """Return the (N,) areas under the deletion or insertion curves.

    Deletion blackens the most important pixels first, insertion puts them into a blurred image
    (Petsiuk et al., RISE, 2018). The curve is the probability of the target output over the share
    of the sector's pixels. A good map has a small area in deletion and a large one in insertion.

    `images` are (N, 128, 128) uint8, `params` (N, 9) and held fixed, `targets` (N,) int64, `maps`
    (N, 128, 128) and large where important, `sector` (128, 128) bool. `insert`: insertion, or else
    deletion. `logits`: outputs are logits, to be turned into probabilities.
    """
    place, full = ranks(maps, sector), images.float()
    empty = blur(full, BLUR) * sector if insert else torch.zeros_like(full)
    curve = []
    for share in torch.linspace(0.0, 1.0, POINTS):
        taken = place < share
        shown = torch.where(taken == insert, full, empty)
        found = outputs(judge, shown, params)
        found = found.softmax(-1) if logits else found
        curve.append(found.gather(1, targets.unsqueeze(1)).squeeze(1))
    height = torch.stack(curve).double()
    return ((height[:-1] + height[1:]) / 2).mean(0).cpu().numpy()


def overlap(maps: Tensor, region: Tensor, sector: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Return where the top of (N, H, W) maps lies, which are large where important.

    The (N,) share of the top tenth of the (H, W) sector's pixels that lies in the (N, H, W) bool
    region, and the (N,) share of the sector that the region is: what a map that knows nothing would
    have.
    """
    region = region & sector
    top = ranks(maps, sector) < TOP
    hit = (top & region).flatten(1).sum(1) / top.flatten(1).sum(1)
    chance = region.flatten(1).sum(1) / sector.sum()
    return hit.cpu().numpy(), chance.cpu().numpy()
