"""Noise and parameters to gray levels in one module, as an exported generator runs."""

from torch import Tensor, nn

from racines_models.networks.convolution import to_gray


class Painter(nn.Module):
    """A conditioning and a network `(latent, condition) -> (B, 1, 128, 128)` in [-1, 1]."""

    def __init__(self, conditioning: nn.Module, network: nn.Module):
        super().__init__()
        self.conditioning, self.network = conditioning, network

    def forward(self, parameters: Tensor, noise: Tensor) -> Tensor:
        """Return (B, 128, 128) uint8 of (B, 12) parameters and (B, latent) noise."""
        return to_gray(self.network(noise, self.conditioning(parameters)))
