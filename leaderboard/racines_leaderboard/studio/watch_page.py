"""Attributions laid over an image, in colours that stand out from gray."""

import numpy as np
from PIL import Image

ENLARGED = 3
"""Times the image's size: attributions are smooth, the image keeps its pixels."""
SOFT = 1.2
"""Blur of the drawn attributions, pixels."""
FOR, AGAINST = np.array([255.0, 70.0, 50.0]), np.array([70.0, 150.0, 255.0])


def overlay(image: np.ndarray, attributions: np.ndarray) -> np.ndarray:
    """Return an image with its attributions: red speaks for what is explained, blue against.

    Args:
        image: (128, 128) uint8.
        attributions: (128, 128); the strongest hundredth is opaque.

    Returns:
        (384, 384, 3) uint8.
    """
    import torch

    from racines_envs.explain.scores import blur

    soft = blur(torch.from_numpy(attributions).float().unsqueeze(0), SOFT)[0].numpy()
    scale = max(float(np.quantile(np.abs(soft), 0.99)), 1e-12)
    share = _enlarge(soft / scale).clip(-1.0, 1.0)[..., None]
    gray = _enlarge(image.astype(np.float32))[..., None].clip(0.0, 255.0)
    strength = np.abs(share) ** 0.8
    colour = np.where(share > 0, FOR, AGAINST)
    return (0.8 * gray * (1.0 - strength) + colour * strength).round().astype(np.uint8)


def _enlarge(values: np.ndarray) -> np.ndarray:
    """Return (128, 128) numbers enlarged, interpolated."""
    size = values.shape[1] * ENLARGED, values.shape[0] * ENLARGED
    picture = Image.fromarray(values.astype(np.float32))
    return np.asarray(picture.resize(size, Image.Resampling.BILINEAR))
