"""The paper's generator: a conditional VAE whose decoder is also a GAN's generator."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor, nn
from torch.nn.functional import mse_loss
from torch.optim import Adam, Optimizer

from racines_data.errors import RacinesError
from racines_data.randomness import derive, normal, sample_seeds
from racines_models.generators.adversarial import AdversarialGenerator
from racines_models.networks.batching import in_fixed_batches
from racines_models.networks.conditioning import Conditioning
from racines_models.networks.convolution import frozen, to_gray, to_range
from racines_models.networks.discriminator import Discriminator
from racines_models.networks.framing import Framed
from racines_models.networks.injection import check_injection
from racines_models.networks.onnx_module import NoiseInput, OnnxModule
from racines_models.networks.painting import Painter
from racines_models.networks.pyramid import Pyramid
from racines_models.networks.vae_gan import Encoder
from racines_models.training.adversary import Adversary
from racines_models.training.objective import TrainBatch, Training, Update

POSTERIOR, PRIOR, DRAW, AUGMENT = 1, 2, 3, 4
"""Random streams: noise of the posterior, of the prior in training, of the prior at drawing, and
changes of the augmentation."""


def _adversary() -> Adversary:
    return Adversary(joining="last", normalisation="batch", r1=0.0)


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
    adversary: Adversary = field(default_factory=_adversary)
    training: Training = field(default_factory=Training)

    def __post_init__(self) -> None:
        """Refuse sizes and weights that cannot train."""
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

    def build(self) -> nn.ModuleDict:
        """Return the networks in the order that fixes their initial weights."""
        config, adversary = self.config, self.config.adversary
        conditioning = Conditioning(config.conditioning)
        injected = {"injection": config.injection, "embedding": config.embedding}
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            nets = {
                "conditioning": conditioning,
                "encoder": Encoder(config.encoder_width, config.latent),
                "decoder": Framed(
                    Pyramid(config.width, config.latent, conditioning.width, **injected)
                ),
                "discriminator": Discriminator(
                    config.discriminator_width,
                    conditioning.width,
                    config.embedding,
                    joining=adversary.joining,
                    normalisation=adversary.normalisation,
                ),
            }
        # Channels last is the faster order on CPU and GPU; fixed here, since orders round apart.
        return nn.ModuleDict(nets).to(memory_format=torch.channels_last)  # pyright: ignore

    def modules(self) -> dict[str, nn.Module]:
        """Return encoder, decoder and discriminator."""
        return {name: self.net(name) for name in ("encoder", "decoder", "discriminator")}

    def averaged(self) -> tuple[str, ...]:
        """Name the decoder, which draws, and the encoder, which is saved beside it."""
        return ("encoder", "decoder")

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

        adversary, critic = config.adversary, self.net("discriminator")
        seeds = derive(batch.seeds, AUGMENT)
        seen = adversary.view(drawn, seeds)
        yield adversary.critic_update(nets["discriminator"], critic, real, seen, condition, seeds)

        reconstruction = mse_loss(rebuilt.float(), real)
        kl = 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).float().mean()
        with frozen(critic):
            adversarial = adversary.generator_loss(nets["discriminator"](seen, condition))
        loss = (
            config.reconstruction_weight * reconstruction
            + config.kl_weight * kl
            + config.adversarial_weight * adversarial
        )
        logged = {"reconstruction": reconstruction, "kl": kl, "adversarial": adversarial}
        yield Update("vae", loss, logged)

    def draw(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        """Decode prior noise of each sample's seed with its condition."""
        seeds = sample_seeds(seed, len(parameters), parameters.device)
        decoder, conditioning = self.net("decoder").eval(), self.net("conditioning")

        def decode(parameters: Tensor, seeds: Tensor) -> Tensor:
            noise = normal(derive(seeds, DRAW), self.config.latent)
            return to_gray(decoder(noise, conditioning(parameters)))

        return in_fixed_batches(decode, parameters, seeds)

    def onnx_module(self) -> OnnxModule:
        """Return conditioning and decoder."""
        painter = Painter(self.net("conditioning"), self.net("decoder"))
        return OnnxModule(painter, NoiseInput(self.config.latent, (DRAW,)))
