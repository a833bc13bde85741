"""The paper's baseline cGAN: deconvolutions against convolutions, told the condition."""

from dataclasses import dataclass
from typing import ClassVar

from racines_models.generators.gan import PyramidGan, PyramidGanConfig


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
