"""What a drawn image costs: structural similarity and absolute error, differentiable and cheap."""

import torch
from torch import Tensor

WINDOW, SIGMA = 11, 1.5
"""The window of Wang et al. (2004), as in the score."""


def image_loss(drawn: Tensor, truth: Tensor) -> tuple[Tensor, Tensor]:
    """Return the mean SSIM and a smooth absolute error of (B, H, W) images, black 0 and white 1."""
    error = ((drawn - truth).square() + 1e-4).sqrt().mean()
    return similarity(drawn, truth), error


def similarity(drawn: Tensor, truth: Tensor) -> Tensor:
    """Return the mean SSIM where the window is whole; the blur is two matrix products."""
    rows = _window(drawn.shape[1], drawn)
    columns = _window(drawn.shape[2], drawn).T
    maps = torch.stack([drawn, truth, drawn * drawn, truth * truth, drawn * truth])
    a, b, aa, bb, ab = rows @ maps @ columns
    spread, shared = aa - a * a + bb - b * b, ab - a * b
    value = (2.0 * a * b + 1e-4) * (2.0 * shared + 9e-4)
    return (value / ((a * a + b * b + 1e-4) * (spread + 9e-4))).mean()


def _window(size: int, like: Tensor) -> Tensor:
    """Return the (size - 10, size) matrix that blurs along an axis."""
    taps = torch.exp(-0.5 * ((torch.arange(WINDOW) - WINDOW // 2) / SIGMA) ** 2)
    taps = (taps / taps.sum()).to(like)
    start = torch.arange(size - WINDOW + 1, device=like.device).unsqueeze(1)
    offset = torch.arange(size, device=like.device).unsqueeze(0) - start
    return taps[offset.clamp(0, WINDOW - 1)] * ((offset >= 0) & (offset < WINDOW))
