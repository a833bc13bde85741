"""The encoder of the conditional VAE-GAN; its other networks are those of every GAN here."""

from torch import Tensor, nn

from racines_models.networks.convolution import bottom_features, downward, initialise

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
