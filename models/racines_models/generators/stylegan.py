"""The paper's conditional StyleGAN: a style made of noise and condition scales every layer."""

from dataclasses import dataclass
from typing import ClassVar

from torch import nn

from racines_data.errors import RacinesError
from racines_models.generators.cgan import ConditionalGan, GanConfig
from racines_models.networks.style import StyleSynthesis


@dataclass(frozen=True)
class StyleGanConfig(GanConfig):
    """Sizes of the mapping network beside what every GAN has."""

    name: ClassVar[str] = "stylegan"
    discriminator_width: int = 12
    style: int = 128
    """Entries of the style w."""
    mapping_layers: int = 4
    mapping_rate: float = 0.1
    """Learning rate of the mapping network, as a share of the others'; StyleGAN's 0.01 asks for its
    25 million images."""
    learning_rate: float = 2e-3
    discriminator_learning_rate: float = 5e-4
    beta1: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if min(self.style, self.mapping_layers) < 1 or self.mapping_rate <= 0:
            raise RacinesError(f"{self.name}: style, mapping_layers and mapping_rate are above 0")


class StyleGan(ConditionalGan[StyleGanConfig]):
    """StyleGAN2's generator against a residual discriminator, R1 in place of a norm."""

    name = "stylegan"
    Config = StyleGanConfig
    title = "Conditional StyleGAN"
    summary = "A style made of noise and the probe's parameters modulates every convolution."
    source = (
        "the RACINES paper, section 'Performance of the Image Generation Models' (conditional "
        "StyleGAN); Karras et al., 2019 and 2020"
    )
    limits = (
        "no loss compares its image with the frame of that pose",
        "no style mixing, no path-length regularisation: the condition fixes most of the style",
    )

    def networks(self, condition: int) -> dict[str, nn.Module]:
        """Return StyleGAN2's generator and a residual discriminator."""
        config = self.config
        sizes = config.width, config.latent, condition, config.style
        generator = StyleSynthesis(*sizes, layers=config.mapping_layers, rate=config.mapping_rate)
        discriminator = self.discriminator(condition, residual=True)
        return {"generator": generator, "discriminator": discriminator}
