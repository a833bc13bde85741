"""What a generator hands over to be exported: one network, and the noise that it takes."""

from dataclasses import dataclass

from torch import Tensor, nn

from racines_data.randomness import derive, normal


@dataclass(frozen=True)
class NoiseInput:
    """Standard normal noise of a sample: `normal(derive(seed, *keys), size)`."""

    size: int
    """Numbers a sample."""
    keys: tuple[int, ...] = ()
    """Keys that the generator derives its own random stream with, from the sample's seed."""

    def draw(self, seeds: Tensor) -> Tensor:
        """Return (B, size) float32 noise of (B,) int64 seeds."""
        return normal(derive(seeds, *self.keys), self.size)


@dataclass(frozen=True)
class OnnxModule:
    """A network that draws, without Python around it.

    `network(parameters)` or, with noise, `network(parameters, noise)` takes (B, 12) float32
    parameters, whose forces may be NaN, and (B, size) float32 noise; it returns (B, 128, 128) uint8
    gray levels. It must be traceable by `torch.export` with any B.
    """

    network: nn.Module
    noise: NoiseInput | None = None
    """None: the image follows from the pose alone."""
