"""The paper's attention cGAN: both pyramids attend over whole maps at 32×32."""

from dataclasses import dataclass
from typing import ClassVar

from racines_models.generators.cgan import PyramidGan, PyramidGanConfig


@dataclass(frozen=True)
class AttentionCganConfig(PyramidGanConfig):
    """As `PyramidGanConfig`."""

    name: ClassVar[str] = "attention-cgan"


class AttentionCgan(PyramidGan):
    """The cGAN with one self-attention layer (Zhang et al., 2019) in each network."""

    name = "attention-cgan"
    Config = AttentionCganConfig
    attention = True
    title = "Attention cGAN"
    summary = "A conditional GAN whose layers at 32×32 look at the whole image."
    source = (
        "the RACINES paper, section 'Performance of the Image Generation Models' (attention "
        "cGAN); Zhang et al., Self-Attention Generative Adversarial Networks, 2019"
    )
    limits = (
        "no loss compares its image with the frame of that pose",
        "attends at one resolution only, which is what a CPU affords",
    )
