"""The paper's baseline cGAN, and what its four plain GANs share: one loss, no encoder."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

from torch import nn
from torch.nn.functional import l1_loss
from torch.optim import Adam, Optimizer

from racines_data.errors import RacinesError
from racines_data.randomness import derive, normal
from racines_models.generators.learned import AdversarialGenerator
from racines_models.networks.layers import check_injection
from racines_models.networks.painting import to_range
from racines_models.networks.pyramid import Pyramid
from racines_models.training.adversary import Adversary
from racines_models.training.objective import TrainBatch, Training, Update

LATENT = 1
"""Random stream: the latents of training."""


@dataclass(frozen=True)
class GanConfig:
    """Sizes, losses and loop; the paper states latent, learning rate, batch and epochs only."""

    name: ClassVar[str] = "gan"
    width: int = 16
    """Channels of the generator's finest maps; the coarsest have eight times as many."""
    discriminator_width: int = 16
    latent: int = 100
    embedding: int = 64
    """Width of the condition's embedding, in the discriminator and where layers use one."""
    conditioning: str = "continuous"
    """`continuous`, or `euler` for the raw twelve columns."""
    learning_rate: float = 5e-4
    """The paper's 1e-4 asks for its ten million images."""
    discriminator_learning_rate: float = 5e-4
    beta1: float = 0.5
    """Adam's first moment decay; the GAN custom, the paper is silent."""
    reconstruction_weight: float = 0.0
    """Weight of the mean absolute error against the true frame, beside an adversarial loss of 1
    (Isola et al., 2017); 0, as in the paper, leaves a plain GAN."""
    sector: bool = True
    """Keep pixels black that are black in every training image; the paper is silent."""
    adversary: Adversary = Adversary()
    training: Training = Training()

    def __post_init__(self) -> None:
        sizes = (self.width, self.discriminator_width, self.latent, self.embedding)
        if min(sizes) < 1:
            raise RacinesError(f"{self.name}: widths, latent and embedding are at least 1")
        if self.reconstruction_weight < 0:
            raise RacinesError(f"{self.name}.reconstruction_weight: 0 or more")
        if min(self.learning_rate, self.discriminator_learning_rate) <= 0:
            raise RacinesError(f"{self.name}: learning rates are above 0")


@dataclass(frozen=True)
class PyramidGanConfig(GanConfig):
    """A GAN whose generator is a `Pyramid`, and where its condition enters."""

    injection: str = "norm"
    """`norm`: at the input and in every normalisation; `concat`: at the input only."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_injection(self.injection, self.name)


C = TypeVar("C", bound=GanConfig)


class ConditionalGan(AdversarialGenerator[C]):
    """A generator, which says how much `noise` it takes, against a discriminator."""

    def optimizers(self) -> dict[str, Optimizer]:
        """Return one Adam a network."""
        config, betas = self.config, (self.config.beta1, 0.999)
        critic = self.net("discriminator").parameters()
        return {
            "discriminator": Adam(critic, config.discriminator_learning_rate, betas),
            "generator": Adam(self.net("generator").parameters(), config.learning_rate, betas),
        }

    def updates(self, nets: Mapping[str, nn.Module], batch: TrainBatch) -> Iterator[Update]:
        """Yield the discriminator's step, then the generator's, on the same drawn images."""
        config, real = self.config, to_range(batch.images)
        condition = self.net("conditioning")(batch.parameters)
        noise = normal(derive(batch.seeds, LATENT), self.net("generator").noise)
        drawn = nets["generator"](noise, condition)
        judged = nets["discriminator"], self.net("discriminator"), real
        adversarial = yield from config.adversary.contest(*judged, drawn, condition, batch.seeds)
        reconstruction = l1_loss(drawn.float(), real)
        loss = adversarial
        if config.reconstruction_weight:
            loss = loss + config.reconstruction_weight * reconstruction
        logged = {"adversarial": adversarial, "reconstruction": reconstruction}
        yield Update("generator", loss, logged)


class PyramidGan(ConditionalGan[PyramidGanConfig]):
    """A GAN of two pyramids, whose layers a subclass makes residual or lets attend."""

    residual: ClassVar[bool] = False
    attention: ClassVar[bool] = False

    def networks(self, condition: int) -> dict[str, nn.Module]:
        """Return a `Pyramid` and its `Discriminator`, of the same kind of layers."""
        config = self.config
        kind: dict[str, Any] = {"residual": self.residual, "attention": self.attention}
        injected = {"injection": config.injection, "embedding": config.embedding}
        generator = Pyramid(config.width, config.latent, condition, **injected, **kind)
        return {"generator": generator, "discriminator": self.discriminator(condition, **kind)}


@dataclass(frozen=True)
class CganConfig(PyramidGanConfig):
    """As `PyramidGanConfig`."""

    name: ClassVar[str] = "cgan"


class Cgan(PyramidGan):
    """DCGAN's pyramids (Radford et al., 2016) with the condition in every layer."""

    name = "cgan"
    Config = CganConfig
    title = "Conditional GAN"
    summary = "Deconvolutions turn noise and the probe's parameters into an image."
    source = (
        "the RACINES paper, section 'Performance of the Image Generation Models' (baseline cGAN); "
        "Mirza and Osindero, 2014; Radford et al., 2016"
    )
    limits = (
        "no loss compares its image with the frame of that pose: it draws a likely image, and "
        "fits the pose only as far as the discriminator tells",
    )
