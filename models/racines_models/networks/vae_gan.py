"""The three networks of the conditional VAE-GAN."""

import torch
from torch import Tensor, nn

from racines_models.networks.convolution import bottom_features, downward, initialise, upward

LOG_VARIANCE = 10.0
"""Bound of the posterior's log variance, so that its exponential stays finite."""


class Encoder(nn.Module):
    """Image to posterior: convolutions, flatten, mean and log variance of the latent."""

    def __init__(self, width: int, latent: int):
        super().__init__()
        self.features = downward(width)
        self.posterior = nn.Linear(bottom_features(width), 2 * latent)
        self.apply(initialise)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Return (B, latent) mean and log variance of (B, 1, 128, 128) images in [-1, 1]."""
        mean, log_variance = self.posterior(self.features(images)).chunk(2, -1)
        return mean, log_variance.clamp(-LOG_VARIANCE, LOG_VARIANCE)


class Decoder(nn.Module):
    """Latent and condition to image: the VAE's decoder and the GAN's generator in one."""

    def __init__(self, width: int, latent: int, condition: int):
        super().__init__()
        self.layers = upward(latent + condition, width)
        self.apply(initialise)

    def forward(self, latent: Tensor, condition: Tensor) -> Tensor:
        """Return (B, 1, 128, 128) images in [-1, 1]; the condition enters here and only here."""
        return self.layers(torch.cat([latent, condition], -1))


class Discriminator(nn.Module):
    """Scores image and condition, which meet only at the last layer."""

    def __init__(self, width: int, condition: int, embedding: int):
        super().__init__()
        self.features = downward(width)
        self.embedding = nn.Sequential(
            nn.Linear(condition, embedding, bias=False),
            nn.BatchNorm1d(embedding),
            nn.LeakyReLU(0.2, inplace=True),
        )
        self.verdict = nn.Linear(bottom_features(width) + embedding, 1)
        self.apply(initialise)

    def forward(self, images: Tensor, condition: Tensor) -> Tensor:
        """Return (B,) logits: large for a real image at its own condition."""
        joined = torch.cat([self.features(images), self.embedding(condition)], -1)
        return self.verdict(joined).squeeze(-1)
