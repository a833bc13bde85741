"""The adversarial half of every GAN here: its settings, its losses, and its regularisation.

Among the latter differentiable augmentation: random changes that gradients pass through, one a
sample's seed (Zhao et al., Differentiable Augmentation for Data-Efficient GAN Training, 2020).
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import softplus

from racines_data.errors import RacinesError
from racines_data.randomness import derive, uniform
from racines_models.networks.layers import frozen
from racines_models.networks.pyramid import JOININGS, NORMALISATIONS, Discriminator
from racines_models.training.objective import Update

LOSSES = ("non-saturating", "hinge")
AUGMENT, STREAM = 4, 41
"""Random streams: the augmentation among all of a sample's, and its changes."""
SHIFT = 1 / 8
"""Largest shift, as a share of the side."""
HOLE = 1 / 2
"""Side of the cut-out square, as a share of the side."""


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
        choices = {"loss": LOSSES, "joining": JOININGS, "normalisation": NORMALISATIONS}
        for key, known in choices.items():
            value = getattr(self, key)
            if value not in known:
                raise RacinesError(f"adversary.{key}: {value!r}: use one of {', '.join(known)}")
        unknown = [name for name in self.augment if name not in CHANGES]
        if unknown:
            raise RacinesError(f"adversary.augment: {unknown[0]!r}: use of {', '.join(CHANGES)}")
        if self.r1 < 0 or self.r1_every < 1:
            raise RacinesError("adversary: r1 is 0 or more, r1_every at least 1")

    def contest(
        self,
        judge: Callable[[Tensor, Tensor], Tensor],
        critic: Discriminator,
        real: Tensor,
        drawn: Tensor,
        condition: Tensor,
        seeds: Tensor,
    ) -> Generator[Update, None, Tensor]:
        """Yield the discriminator's step, then return the generator's loss by the stepped one.

        `judge` is the discriminator as the trainer wraps it, `critic` itself. `real` are
        (B, 1, 128, 128) frames in [-1, 1], `drawn` images of the same poses, which have a
        (B, condition) and a (B,) seed each.
        """
        seeds = derive(seeds, AUGMENT)
        seen = augment(drawn, seeds, self.augment)
        of_real = judge(augment(real, seeds, self.augment), condition)
        loss = self.critic_loss(of_real, judge(seen.detach(), condition))
        logged = {"discriminator": loss}
        penalty = self.penalty(critic, real, condition, seeds)
        if penalty is not None:
            logged["r1"] = penalty
            loss = loss + penalty
        yield Update("discriminator", loss, logged)
        with frozen(critic):
            return self.generator_loss(judge(seen, condition))

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
        critic.judged += 1
        if (int(critic.judged) - 1) % self.r1_every:
            return None
        with torch.autocast(images.device.type, enabled=False):
            square = gradient_square(
                lambda x: critic.judge(augment(x, seeds, self.augment), condition.float()),
                images.float(),
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


def augment(images: Tensor, seeds: Tensor, changes: Sequence[str]) -> Tensor:
    """Apply changes in order to (B, C, H, W) images in [-1, 1]; (B,) seeds say how.

    Equal seeds give equal changes, so real and drawn images can undergo the same.
    """
    if not changes:
        return images
    drawn = uniform(seeds, 2 * len(CHANGES), STREAM).to(images.device)
    for change in changes:
        place = 2 * list(CHANGES).index(change)
        images = CHANGES[change](images, drawn[:, place : place + 2])
    return images


def _brightness(images: Tensor, u: Tensor) -> Tensor:
    return images + (u[:, :1, None, None] - 0.5)


def _contrast(images: Tensor, u: Tensor) -> Tensor:
    mean = images.mean((1, 2, 3), keepdim=True)
    return mean + (images - mean) * (u[:, :1, None, None] + 0.5)


def _translation(images: Tensor, u: Tensor) -> Tensor:
    """Shift by whole pixels; what comes in from outside is 0, as in the paper."""
    size = images.shape[-1]
    reach = int(size * SHIFT + 0.5)
    shift = (u * (2 * reach + 1)).floor().long() - reach
    rows = torch.arange(images.shape[-2], device=images.device) - shift[:, :1]
    columns = torch.arange(size, device=images.device) - shift[:, 1:]
    batch = torch.arange(len(images), device=images.device)[:, None, None]
    down, right = rows.clamp(0, images.shape[-2] - 1), columns.clamp(0, size - 1)
    moved = images.permute(0, 2, 3, 1)[batch, down[:, :, None], right[:, None, :]]
    inside = _between(rows, 0, images.shape[-2])[:, :, None] & _between(columns, 0, size)[:, None]
    return moved.permute(0, 3, 1, 2) * inside[:, None]


def _cutout(images: Tensor, u: Tensor) -> Tensor:
    size = images.shape[-1]
    hole = int(size * HOLE + 0.5)
    corner = (u * (size + 1)).floor().long() - hole // 2
    places = torch.arange(size, device=images.device)
    rows, columns = (places - corner[:, i : i + 1] for i in (0, 1))
    inside = _between(rows, 0, hole)[:, :, None] & _between(columns, 0, hole)[:, None]
    return images * ~inside[:, None]


def _between(values: Tensor, low: int, high: int) -> Tensor:
    return (values >= low) & (values < high)


CHANGES = {
    "brightness": _brightness,
    "contrast": _contrast,
    "translation": _translation,
    "cutout": _cutout,
}
"""What can be asked for."""
