"""The adversarial half of every GAN here: its settings, its losses, and its regularisation."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import softplus

from racines_data.errors import RacinesError
from racines_models.networks.discriminator import JOININGS, NORMALISATIONS, Discriminator
from racines_models.training.differentiable_augmentation import CHANGES, augment
from racines_models.training.objective import Update

LOSSES = ("non-saturating", "hinge")


@dataclass(frozen=True)
class Adversary:
    """How the discriminator judges, and what keeps it in check; each key switches one thing."""

    loss: str = "non-saturating"
    """`non-saturating`: binary cross-entropy, the generator with swapped labels (Goodfellow et al.,
    2014, section 3); or `hinge` (Miyato et al., 2018)."""
    joining: str = "projection"
    """Where the condition enters: `last`, `layers` or `projection` (see `Discriminator`)."""
    normalisation: str = "none"
    """Of the discriminator: `spectral`, `batch` (the paper), or `none`."""
    r1: float = 1.0
    """Weight γ of the R1 penalty γ/2 · |∇D|² on real images; 0 switches it off."""
    r1_every: int = 16
    """Steps between two penalties, each weighed this many times more (lazy regularisation)."""
    augment: tuple[str, ...] = ()
    """Of `brightness`, `contrast`, `translation`, `cutout`: what real and drawn images undergo."""

    def __post_init__(self) -> None:
        """Refuse what does not exist."""
        for key, known in (
            ("loss", LOSSES),
            ("joining", JOININGS),
            ("normalisation", NORMALISATIONS),
        ):
            if getattr(self, key) not in known:
                raise RacinesError(
                    f"adversary.{key}: {getattr(self, key)!r}: use one of {', '.join(known)}"
                )
        unknown = [name for name in self.augment if name not in CHANGES]
        if unknown:
            raise RacinesError(f"adversary.augment: {unknown[0]!r}: use of {', '.join(CHANGES)}")
        if self.r1 < 0 or self.r1_every < 1:
            raise RacinesError("adversary: r1 is 0 or more, r1_every at least 1")

    def view(self, images: Tensor, seeds: Tensor) -> Tensor:
        """Return (B, 1, H, W) images as the discriminator sees them: augmented by (B,) seeds."""
        return augment(images, seeds, self.augment)

    def critic_update(
        self,
        judge: Callable[[Tensor, Tensor], Tensor],
        critic: Discriminator,
        real: Tensor,
        seen: Tensor,
        condition: Tensor,
        seeds: Tensor,
    ) -> Update:
        """Return the discriminator's step.

        Args:
            judge: the discriminator, as the trainer wraps it.
            critic: the discriminator itself.
            real: (B, 1, 128, 128) frames in [-1, 1].
            seen: (B, 1, 128, 128) drawn images, augmented already.
            condition: (B, condition) of both.
            seeds: (B,) of the augmentation, with which `seen` was made too.
        """
        loss = self.critic_loss(
            judge(self.view(real, seeds), condition), judge(seen.detach(), condition)
        )
        logged = {"discriminator": loss}
        penalty = self.penalty(critic, real, condition, seeds)
        if penalty is not None:
            logged["r1"] = penalty
            loss = loss + penalty
        return Update("discriminator", loss, logged)

    def critic_loss(self, real: Tensor, drawn: Tensor) -> Tensor:
        """Return the discriminator's loss of (B,) logits, a mean over both halves."""
        real, drawn = real.float(), drawn.float()
        if self.loss == "hinge":
            return 0.5 * ((1.0 - real).relu() + (1.0 + drawn).relu()).mean()
        return 0.5 * (softplus(-real) + softplus(drawn)).mean()

    def generator_loss(self, drawn: Tensor) -> Tensor:
        """Return the generator's loss of (B,) logits of what it drew."""
        return -drawn.float().mean() if self.loss == "hinge" else softplus(-drawn.float()).mean()

    def penalty(
        self, critic: Discriminator, images: Tensor, condition: Tensor, seeds: Tensor
    ) -> Tensor | None:
        """Return the weighed R1 term, or None at a step that has none; counts the steps.

        Full precision throughout: second derivatives do not survive eight bits of mantissa.
        """
        if not self.r1:
            return None
        due = int(critic.judged) % self.r1_every == 0
        critic.judged += 1
        if not due:
            return None
        with torch.autocast(images.device.type, enabled=False):
            square = gradient_square(
                lambda x: critic.judge(self.view(x, seeds), condition.float()), images.float()
            )
        return 0.5 * self.r1 * self.r1_every * square


def gradient_square(critic: Callable[[Tensor], Tensor], images: Tensor) -> Tensor:
    """Return the mean over images of |∂ critic / ∂ image|², differentiable in the critic's weights.

    Source: Mescheder et al., Which Training Methods for GANs do actually Converge?, 2018, equation
    9; every few steps as in Karras et al., 2020 (StyleGAN2), section 3.1.
    """
    images = images.detach().requires_grad_(True)
    (gradient,) = torch.autograd.grad(critic(images).sum(), images, create_graph=True)
    return gradient.square().flatten(1).sum(1).mean()
