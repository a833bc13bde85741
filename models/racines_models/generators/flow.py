"""Flow matching from noise to image, conditioned on the probe; drawn in one to four steps."""

import copy
import dataclasses
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import pixel_shuffle, pixel_unshuffle
from torch.optim import Adam, Optimizer

from racines_data.errors import RacinesError
from racines_data.randomness import derive, normal, uniform
from racines_data.store.frames import FrameStore
from racines_models.generators.learned import NetworkGenerator
from racines_models.networks.layers import Conditioning
from racines_models.networks.painting import NoiseInput, OnnxModule, to_gray, to_range
from racines_models.networks.unet import CELL, GRID, SPREAD, PlacedUNet, scales
from racines_models.training.objective import TrainBatch, Training, Update

NOISE, TIME, DRAW = 1, 2, 3
"""Random streams: noise and time in training, noise at drawing."""
SOLVERS = ("euler", "heun")
PIXELS = (GRID * CELL) ** 2


@dataclass(frozen=True)
class FlowConfig:
    """Network, path and solver; docs/flow.md says what each choice brings."""

    width: int = 64
    """Channels at 32×32 cells; twice as many at 16×16, four times at 8×8. A multiple of 8."""
    octaves: int = 6
    """Sines and cosines of each cell's place, from 0.32 m down to 0.32 / 2^(octaves - 1) m."""
    extent: float = 0.219
    """Side of the image, m: what the place of a cell is computed with."""
    conditioning: str = "continuous"
    """`continuous`, or `euler` for the raw twelve columns."""
    learning_rate: float = 1e-3
    pure_noise: float = 0.5
    """Share of the training samples at time 0, where the first step starts; the rest is uniform."""
    preconditioned: bool = False
    """Let the network say what a linear guess cannot know, not the whole frame."""
    steps: int = 1
    """Steps from noise to image at drawing, 1 to 4."""
    solver: str = "euler"
    """`euler`, or `heun`: a second look a step, but for the last, which always is Euler's."""
    spacing: float = 1.0
    """1 - t falls as this power: 1 for equal steps, 2 for steps that shorten towards the end."""
    training: Training = Training()

    def __post_init__(self) -> None:
        if self.width < 8 or self.width % 8:
            raise RacinesError("flow.width: a multiple of 8, for group norm")
        if not 1 <= self.octaves <= 10 or self.extent <= 0:
            raise RacinesError("flow: octaves lie in 1-10 and extent is above 0")
        if self.learning_rate <= 0 or not 0.0 <= self.pure_noise <= 1.0:
            raise RacinesError("flow: learning_rate is above 0 and pure_noise in [0, 1]")
        if self.spacing <= 0:
            raise RacinesError("flow.spacing: above 0")
        if not 1 <= self.steps <= 4 or self.solver not in SOLVERS:
            raise RacinesError(f"flow: steps are 1 to 4 and solver is {' or '.join(SOLVERS)}")


class Flow(NetworkGenerator[FlowConfig]):
    """Straight paths from noise to image, followed by a network that foresees their end."""

    name = "flow"
    Config = FlowConfig
    title = "Flow matching"
    summary = "A U-Net that sees each cell's place in the block moves noise to an image."
    source = (
        "Lipman et al., Flow Matching for Generative Modeling, 2023; "
        "Liu et al., Flow Straight and Fast (rectified flow), 2023"
    )
    stochastic = True
    limits = (
        "one step draws nearly the mean of what a pose may look like: speckle is smooth",
        "several steps draw speckle that looks right but is not that of the place",
    )

    def untrained(self) -> dict[str, nn.Module]:
        """Return the U-Net, which has the conditioning in it."""
        config = self.config
        conditioning = Conditioning(config.conditioning, self.phased)
        sizes = config.width, config.octaves, config.extent, conditioning
        return {"unet": PlacedUNet(*sizes, config.preconditioned, self.metres)}

    def prepare(self, store: FrameStore) -> None:
        """Fit the conditioning."""
        self.net("unet").fit(store.conditions(store.split_indices("train")))

    def optimizers(self) -> dict[str, Optimizer]:
        """Return one Adam."""
        return {"unet": Adam(self.net("unet").parameters(), self.config.learning_rate, (0.9, 0.99))}

    def updates(self, nets: Mapping[str, nn.Module], batch: TrainBatch) -> Iterator[Update]:
        """Yield one step: foresee the image from a point on the way to it.

        The path is x(t) = (1 - t) · noise + t · image, its velocity (image - x) / (1 - t). The
        squared error of the foreseen image is that of the velocity times (1 - t)²: it weighs the
        early times. Preconditioned, it is weighed so that the network's own output counts alike at
        all times (see `scales`): by 1 at time 0, by more where less is left to change.
        """
        image = pixel_unshuffle(to_range(batch.images), CELL)
        image = image.contiguous(memory_format=torch.channels_last)
        time = uniform(derive(batch.seeds, TIME), 2)
        time = time[:, 0].where(time[:, 1] >= self.config.pure_noise, 0.0)
        noise = _folded(normal(derive(batch.seeds, NOISE), PIXELS))
        at = time[:, None, None, None]
        foreseen = nets["unet"](noise.lerp(image, at), time, batch.parameters)
        error = (foreseen.float() - image).square().mean((1, 2, 3))
        weight = (SPREAD / scales(time)[1]).square() if self.config.preconditioned else 1.0
        loss = (error * weight).mean()
        pure = (time == 0.0).float()
        first = (error.detach() * pure).sum() / pure.sum().clamp_min(1.0)
        yield Update("unet", loss, {"loss": loss, "first_step": first})

    def with_steps(self, steps: int, solver: str = "euler") -> "Flow":
        """Return the same fitted flow, drawn in other steps."""
        other = copy.copy(self)
        other.config = dataclasses.replace(self.config, steps=steps, solver=solver)
        return other

    def onnx_module(self) -> OnnxModule:
        """Return the U-Net with its steps."""
        config = self.config
        journey = Journey(self.net("unet"), config.steps, config.solver, config.spacing)
        return OnnxModule(journey, NoiseInput(PIXELS, (DRAW,)))


class Journey(nn.Module):
    """All steps from noise to gray levels."""

    def __init__(self, unet: nn.Module, steps: int, solver: str, spacing: float):
        super().__init__()
        self.unet, self.steps, self.solver, self.spacing = unet, steps, solver, spacing

    def forward(self, parameters: Tensor, noise: Tensor) -> Tensor:
        """Return (B, 128, 128) uint8 of (B, 12) parameters and (B, 16384) noise."""
        x = _folded(noise)
        images = follow(self.unet, x, parameters, self.steps, self.solver, self.spacing)
        return to_gray(pixel_shuffle(images, CELL))


def follow(
    unet: Callable[..., Tensor], x: Tensor, parameters: Tensor, steps: int, solver: str,
    spacing: float = 1.0,
) -> Tensor:  # fmt: skip
    """Return the images at the end of the flow from noise `x`, in its shape.

    The last step ends in the mean of what the image may still be, so that a late last step
    (`spacing` above 1) keeps more speckle. Heun's second slope would divide by 0 at the end of the
    last step, where Euler's step is the foreseen image itself.
    """
    for step in range(steps):
        now, then = (1.0 - (1.0 - at / steps) ** spacing for at in (step, step + 1))
        slope = _slope(unet, x, now, parameters)
        moved = x + (then - now) * slope
        if solver == "heun" and step + 1 < steps:
            moved = x + (then - now) * 0.5 * (slope + _slope(unet, moved, then, parameters))
        x = moved
    return x


def _slope(unet: Callable[..., Tensor], x: Tensor, time: float, parameters: Tensor) -> Tensor:
    foreseen = unet(x, x.new_full((x.shape[0],), time), parameters)
    return (foreseen.float() - x) / (1.0 - time)


def _folded(noise: Tensor) -> Tensor:
    """Return (B, 16384) noise as (B, 16, 32, 32), channels last."""
    return noise.view(-1, GRID, GRID, CELL * CELL).permute(0, 3, 1, 2)
