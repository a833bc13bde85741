"""The paper's residual cGAN: residual blocks, with the condition injected in every layer."""

from dataclasses import dataclass
from typing import ClassVar

from racines_models.generators.cgan import PyramidGan, PyramidGanConfig


@dataclass(frozen=True)
class ResidualCganConfig(PyramidGanConfig):
    """As `PyramidGanConfig`, with a discriminator that costs no more than the others."""

    name: ClassVar[str] = "residual-cgan"
    discriminator_width: int = 12


class ResidualCgan(PyramidGan):
    """Residual blocks (He et al., 2016) in both networks, as in SNGAN (Miyato et al., 2018)."""

    name = "residual-cgan"
    Config = ResidualCganConfig
    residual = True
    title = "Residual cGAN"
    summary = "A conditional GAN of residual blocks, each normed by the condition."
    source = (
        "the RACINES paper, section 'Performance of the Image Generation Models' (residual cGAN); "
        "He et al., 2016; Miyato et al., Spectral Normalization for GANs, 2018"
    )
    limits = ("no loss compares its image with the frame of that pose",)
