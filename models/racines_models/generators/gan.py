"""What the paper's four plain GANs share: two networks, one adversarial loss, no encoder."""

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import ClassVar, TypeVar

import torch
from torch import Tensor, nn
from torch.nn.functional import l1_loss
from torch.optim import Adam, Optimizer

from racines_data.errors import RacinesError
from racines_data.randomness import derive, normal, sample_seeds
from racines_models.generators.adversarial import AdversarialGenerator
from racines_models.networks.batching import in_fixed_batches
from racines_models.networks.conditioning import Conditioning
from racines_models.networks.convolution import frozen, to_range
from racines_models.networks.discriminator import Discriminator
from racines_models.networks.framing import Framed
from racines_models.networks.injection import check_injection
from racines_models.networks.onnx_module import NoiseInput, OnnxModule
from racines_models.networks.painting import Painter
from racines_models.networks.pyramid import Pyramid
from racines_models.training.adversary import Adversary
from racines_models.training.objective import TrainBatch, Training, Update

LATENT, DRAW, AUGMENT = 1, 3, 4
"""Random streams: latents of training and of drawing, changes of the augmentation."""


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
    adversary: Adversary = field(default_factory=Adversary)
    training: Training = field(default_factory=Training)

    def __post_init__(self) -> None:
        """Refuse sizes and weights that cannot train."""
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
        """Refuse what cannot train."""
        super().__post_init__()
        check_injection(self.injection, self.name)


C = TypeVar("C", bound=GanConfig)


class ConditionalGan(AdversarialGenerator[C]):
    """A generator against a discriminator, both told the condition; a subclass builds them."""

    @abstractmethod
    def networks(self, condition: int) -> dict[str, nn.Module]:
        """Return `generator` and `discriminator` for a condition of that width.

        The generator turns (B, `noise`) normal numbers, of which it says how many it takes, and
        (B, condition) into (B, 1, 128, 128) in [-1, 1].
        """

    def build(self) -> nn.ModuleDict:
        """Return the networks in the order that fixes their initial weights."""
        conditioning = Conditioning(self.config.conditioning)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            nets = {"conditioning": conditioning, **self.networks(conditioning.width)}
        nets["generator"] = Framed(nets["generator"])
        # Channels last is the faster order on CPU and GPU; fixed here, since orders round apart.
        return nn.ModuleDict(nets).to(memory_format=torch.channels_last)  # pyright: ignore

    def modules(self) -> dict[str, nn.Module]:
        """Return generator and discriminator."""
        return {name: self.net(name) for name in ("generator", "discriminator")}

    def averaged(self) -> tuple[str, ...]:
        """Name the generator, which draws."""
        return ("generator",)

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
        adversary, critic = self.config.adversary, self.net("discriminator")
        real = to_range(batch.images)
        condition = self.net("conditioning")(batch.parameters)
        noise = normal(derive(batch.seeds, LATENT), self.net("generator").noise)
        drawn = nets["generator"](noise, condition)
        seeds = derive(batch.seeds, AUGMENT)
        seen = adversary.view(drawn, seeds)

        yield adversary.critic_update(nets["discriminator"], critic, real, seen, condition, seeds)
        with frozen(critic):
            adversarial = adversary.generator_loss(nets["discriminator"](seen, condition))
        reconstruction = l1_loss(drawn.float(), real)
        loss = adversarial
        if self.config.reconstruction_weight:
            loss = loss + self.config.reconstruction_weight * reconstruction
        logged = {"adversarial": adversarial, "reconstruction": reconstruction}
        yield Update("generator", loss, logged)

    def draw(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        """Draw noise of each sample's seed with its condition."""
        seeds = sample_seeds(seed, len(parameters), parameters.device)
        generator = self.net("generator").eval()
        painter = Painter(self.net("conditioning"), generator)

        def paint(parameters: Tensor, seeds: Tensor) -> Tensor:
            return painter(parameters, normal(derive(seeds, DRAW), generator.noise))

        return in_fixed_batches(paint, parameters, seeds)

    def onnx_module(self) -> OnnxModule:
        """Return conditioning and generator."""
        generator = self.net("generator")
        painter = Painter(self.net("conditioning"), generator)
        return OnnxModule(painter, NoiseInput(generator.noise, (DRAW,)))


class PyramidGan(ConditionalGan[PyramidGanConfig]):
    """A GAN of two pyramids, whose layers a subclass makes residual or lets attend."""

    residual: ClassVar[bool] = False
    attention: ClassVar[bool] = False

    def networks(self, condition: int) -> dict[str, nn.Module]:
        """Return a `Pyramid` and its `Discriminator`, of the same kind of layers."""
        config, adversary = self.config, self.config.adversary
        kind = {"residual": self.residual, "attention": self.attention}
        generator = Pyramid(
            config.width,
            config.latent,
            condition,
            injection=config.injection,
            embedding=config.embedding,
            **kind,
        )
        discriminator = Discriminator(
            config.discriminator_width,
            condition,
            config.embedding,
            joining=adversary.joining,
            normalisation=adversary.normalisation,
            **kind,
        )
        return {"generator": generator, "discriminator": discriminator}
