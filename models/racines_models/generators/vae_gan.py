"""The paper's generator: a conditional VAE whose decoder is also a GAN's generator."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn.functional import mse_loss
from torch.optim import Adam, Optimizer

from racines_data.errors import RacinesError
from racines_data.randomness import derive, normal
from racines_models.generators.learned import AdversarialGenerator
from racines_models.networks.layers import bottom_features, check_injection, initialise, widths
from racines_models.networks.painting import to_range
from racines_models.networks.pyramid import Pyramid
from racines_models.training.adversary import Adversary
from racines_models.training.objective import TrainBatch, Training, Update

POSTERIOR, PRIOR = 1, 2
"""Random streams: noise of the posterior, and of the prior in training."""
LOG_VARIANCE = 10.0
"""Bound of the posterior's log variance, so that its exponential stays finite."""


@dataclass(frozen=True)
class VaeGanConfig:
    """Sizes, losses and loop; the paper states latent, learning rate, batch and epochs only."""

    width: int = 16
    """Channels at the decoder's finest level; the coarsest has eight times as many."""
    encoder_width: int = 8
    discriminator_width: int = 8
    """The same of the networks that only train: narrower ones cost a CPU less and lose little."""
    latent: int = 100
    embedding: int = 64
    """Width of the condition's embedding, in the discriminator and where norms use one."""
    conditioning: str = "continuous"
    """`continuous`, or `euler` for the raw twelve columns."""
    injection: str = "concat"
    """`concat`: the condition enters the decoder beside the latent only, as in the paper; `norm`:
    and in every normalisation."""
    learning_rate: float = 1e-3
    """The paper's 1e-4 asks for its ten million images."""
    beta1: float = 0.5
    """Adam's first moment decay; the GAN custom, the paper is silent."""
    reconstruction_weight: float = 1.0
    kl_weight: float = 3.0
    """On the mean over latent entries; 3 ends near the paper's KL of 0.0013. At 0.1 the latent
    carries what the pose should, and images from prior noise are unlike any frame."""
    adversarial_weight: float = 0.01
    """At 0.001 images are smoother and score 1 dB more."""
    sector: bool = True
    """Keep pixels black that are black in every training image; the paper is silent."""
    adversary: Adversary = Adversary(joining="last", normalisation="batch", r1=0.0)
    training: Training = Training()

    def __post_init__(self) -> None:
        if min(self.width, self.encoder_width, self.discriminator_width) < 1:
            raise RacinesError("vae-gan: the three widths are at least 1")
        if min(self.latent, self.embedding) < 1:
            raise RacinesError("vae-gan: latent and embedding are at least 1")
        if min(self.reconstruction_weight, self.kl_weight, self.adversarial_weight) < 0:
            raise RacinesError("vae-gan: loss weights are 0 or more")
        if self.learning_rate <= 0:
            raise RacinesError("vae-gan.learning_rate: must be above 0")
        check_injection(self.injection, "vae-gan")


class VaeGan(AdversarialGenerator[VaeGanConfig]):
    """Conditional VAE-GAN: reconstruction, KL and adversarial loss; drawn from prior noise."""

    name = "vae-gan"
    drawing = "decoder"
    Config = VaeGanConfig
    title = "Conditional VAE-GAN"
    summary = "A decoder turns latent noise and the probe's parameters into an image."
    source = "the RACINES paper, section 'Continuous Conditional US Image Generation'"
    limits = (
        "smooths speckle: the reconstruction loss averages what the condition does not fix",
        "weights of the three losses are ours: the paper states none",
    )

    def networks(self, condition: int) -> dict[str, nn.Module]:
        """Return encoder, decoder and discriminator."""
        config = self.config
        injected = {"injection": config.injection, "embedding": config.embedding}
        return {
            "encoder": Encoder(config.encoder_width, config.latent),
            "decoder": Pyramid(config.width, config.latent, condition, **injected),
            "discriminator": self.discriminator(condition),
        }

    def optimizers(self) -> dict[str, Optimizer]:
        """Return one Adam for encoder and decoder, one for the discriminator."""
        rate, betas = self.config.learning_rate, (self.config.beta1, 0.999)
        vae = [*self.net("encoder").parameters(), *self.net("decoder").parameters()]
        return {
            "discriminator": Adam(self.net("discriminator").parameters(), rate, betas),
            "vae": Adam(vae, rate, betas),
        }

    def updates(self, nets: Mapping[str, nn.Module], batch: TrainBatch) -> Iterator[Update]:
        """Yield the discriminator's step, then that of encoder and decoder."""
        config = self.config
        real = to_range(batch.images)
        condition = self.net("conditioning")(batch.parameters)
        mean, log_variance = nets["encoder"](real)
        noise = normal(derive(batch.seeds, POSTERIOR), config.latent)
        posterior = mean + noise * (0.5 * log_variance).exp()
        prior = normal(derive(batch.seeds, PRIOR), config.latent)
        # Both in one pass: the decoder's batch norm then fits the prior, from which it will draw.
        latents, conditions = torch.cat([posterior, prior]), torch.cat([condition, condition])
        rebuilt, drawn = nets["decoder"](latents, conditions).chunk(2)
        judged = nets["discriminator"], self.net("discriminator"), real
        adversarial = yield from config.adversary.contest(*judged, drawn, condition, batch.seeds)
        reconstruction = mse_loss(rebuilt.float(), real)
        kl = 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).float().mean()
        vae = config.reconstruction_weight * reconstruction + config.kl_weight * kl
        loss = vae + config.adversarial_weight * adversarial
        logged = {"reconstruction": reconstruction, "kl": kl, "adversarial": adversarial}
        yield Update("vae", loss, logged)


class Encoder(nn.Module):
    """Image to posterior: convolutions, flatten, mean and log variance of the latent."""

    def __init__(self, width: int, latent: int):
        super().__init__()
        layers: list[nn.Module] = []
        for before, after in pairwise([1, *widths(width)]):
            conv = nn.Conv2d(before, after, 4, stride=2, padding=1, bias=False)
            layers += [conv, nn.BatchNorm2d(after), nn.LeakyReLU(0.2, inplace=True)]
        self.features = nn.Sequential(*layers, nn.Flatten())
        self.posterior = nn.Linear(bottom_features(width), 2 * latent)
        self.apply(initialise)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Return (B, latent) mean and log variance of (B, 1, 128, 128) images in [-1, 1]."""
        mean, log_variance = self.posterior(self.features(images)).chunk(2, -1)
        return mean, log_variance.clamp(-LOG_VARIANCE, LOG_VARIANCE)
