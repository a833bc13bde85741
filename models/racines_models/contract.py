"""The contract of a generator, clause by clause, as checks that name the clause that is broken.

`racines_models.testing.GeneratorContract` asks them of a class, and a board's intake of what is
handed in. What each clause means stands in docs/generators.md, under "The contract".
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE
from racines_data.schema import PARAMETERS
from racines_models.sample import check_drawn

CLAUSES = {
    "G1": "type",
    "G2": "range",
    "G3": "repeats",
    "G4": "new process",
    "G5": "own row",
    "G6": "seed",
    "G7": "pose",
}
"""Names of the clauses by number, in the order in which they are checked."""
PLACES = 8
"""Rows that `check_rows` moves through all places: as many as networks take at once on a CPU."""
SHUFFLES = 199
LEVEL = 0.05
"""Share of the shuffles that may do as well as a generator at its own poses."""
FALL = 0.05
"""dB by which the mean PSNR falls at least: a pixel that moves with the pose is no obedience."""
FEWEST = 8
"""Frames below which shuffling them says nothing."""

Draw = Callable[[Tensor, Tensor], Tensor]
"""From (B, 12) parameters and (B,) seeds to (B, 128, 128) images."""


class ContractError(RacinesError, AssertionError):
    """A broken clause. To a test it is a failed assertion, to a command a refused input."""

    def __init__(self, clause: str, found: str, names: dict[str, str] | None = None) -> None:
        self.clause, self.found, self.names = clause, found, names or CLAUSES
        super().__init__(f"clause {clause} of the contract ({self.names[clause]}): {found}")

    def at(self, where: str) -> Self:
        """Return it with the name of what breaks the clause before it."""
        placed = type(self)(self.clause, self.found, self.names)
        placed.args = (f"{where}: {self}",)
        return placed


@dataclass(frozen=True)
class Declared:
    """What a generator says of itself; None where it does not say."""

    stochastic: bool | None
    """Whether the seed changes the image."""
    conditional: bool | None
    """Whether the pose changes the image."""
    trained: bool | None = None
    """Whether another training of it would end elsewhere."""


def declared(source: Any) -> Declared:
    """Return what a generator's card, or the metadata of its file, declare."""
    told = getattr(source, "card", None) or getattr(source, "interface", source)
    values = (getattr(told, key, None) for key in ("stochastic", "conditional", "trained"))
    return Declared(*(value if isinstance(value, bool) else None for value in values))


def check_declared(told: Declared, how: str) -> None:
    """Check that both are declared; `how` says where the missing one is to stand."""
    for clause, key in (("G6", "stochastic"), ("G7", "conditional")):
        if getattr(told, key) is None:
            what = key.replace("stochastic", "seed").replace("conditional", "pose")
            found = f"undeclared whether the {what} changes the image: {how.format(key=key)}"
            raise ContractError(clause, found)


def check_type(draw: Draw, poses: Tensor, seeds: Tensor) -> None:
    """Check that what is drawn of none, one and all poses are (B, 128, 128) uint8 images."""
    for count in (0, 1, len(poses)):
        images = draw(poses[:count], seeds[:count])
        shape = (count, IMAGE_SIZE, IMAGE_SIZE)
        fits = isinstance(images, Tensor) and images.dtype == torch.uint8
        if not fits or tuple(images.shape) != shape:
            came = f"{images.dtype} {tuple(images.shape)}" if isinstance(images, Tensor) else "none"
            raise ContractError("G1", f"{count} poses gave {came}: give uint8 {shape}")


def check_range(images: Tensor) -> None:
    """Check that images use the gray levels 0-255 and show something."""
    try:
        check_drawn(images)
    except RacinesError as error:
        raise ContractError("G2", str(error)) from error


def check_same(first: Tensor, again: Tensor, clause: str) -> None:
    """Check that images drawn of the same poses and seeds a second time are the same bytes."""
    if first.shape != again.shape or not torch.equal(first, again):
        where = "in a new process" if clause == "G4" else "a second time"
        found = f"the same poses and seeds drawn {where} give other images"
        raise ContractError(clause, f"{found}: draw all chance from the seed of the sample")


def check_rows(draw: Callable[..., Tensor | tuple[Tensor, ...]], *inputs: Tensor) -> None:
    """Check that a row's result depends on its own inputs alone, to the last bit.

    Each of the first eight rows stands at every place, alone, and among all others, which are more
    than one chunk. `draw` turns (B, …) inputs, seeds among them where there are any, into a tensor
    or tensors of (B, …); an `AssertionError` says what differs.
    """

    def results(places: Tensor) -> list[Tensor]:
        drawn = draw(*(x[places] for x in inputs))
        return [drawn] if isinstance(drawn, Tensor) else list(drawn)

    everyone = torch.arange(len(inputs[0]))
    if len(everyone) <= PLACES:
        raise AssertionError(f"give more than {PLACES} rows")
    together = results(everyone)

    def check(places: Tensor, what: str) -> None:
        for whole, part in zip(together, results(places), strict=True):
            if not torch.equal(whole[places], part):
                apart = (whole[places].double() - part.double()).abs()
                raise AssertionError(f"{what}: differs by {float(apart.max()):.3g}")

    check(everyone.flip(0), "in the reverse order")
    for place in range(PLACES):
        check(everyone[:PLACES].roll(place), f"{place} places further on")
        check(everyone[place : place + 1], f"row {place} alone")


def check_own_rows(draw: Draw, poses: Tensor, seeds: Tensor) -> None:
    """Check that an image depends on its own pose and seed alone (see `check_rows`)."""
    try:
        check_rows(draw, poses, seeds)
    except RacinesError:
        raise
    except AssertionError as error:
        remedy = "an image may depend on its own pose and seed alone"
        raise ContractError("G5", f"an image depends on its batch: {error}; {remedy}") from error


def check_seed(first: Tensor, other: Tensor, stochastic: bool) -> None:
    """Check that other seeds change the images of the same poses exactly where declared."""
    changes = not torch.equal(first, other)
    if changes is not stochastic:
        does = "changes the image" if changes else "changes no image"
        fix = "draw the chance from it, or declare" if stochastic else "leave it out, or declare"
        found = f"declared stochastic = {str(stochastic).lower()}, but the seed {does}"
        raise ContractError("G6", f"{found}: {fix} stochastic = {str(changes).lower()}")


def check_pose(first: Tensor, other: Tensor, conditional: bool) -> None:
    """Check that other poses change the images of the same seeds exactly where declared."""
    changes = not torch.equal(first, other)
    if changes is not conditional:
        does = "changes the image" if changes else "changes no image"
        found = f"declared conditional = {str(conditional).lower()}, but the pose {does}"
        raise ContractError("G7", f"{found}: declare conditional = {str(changes).lower()}")


def other_poses(parameters: Tensor) -> Tensor:
    """Return (N, 12) parameters each in the next row; of (N, 13), phases of the beat stay."""
    width = len(PARAMETERS)
    return torch.cat([parameters[:, :width].roll(1, 0), parameters[:, width:]], 1)


def check_followed(images: Tensor, truth: Tensor) -> None:
    """Check that images are nearer to the frames at their own poses than to those at others.

    (N, 128, 128) uint8 each, eight frames at least. Since an image depends on its own pose alone,
    images of shuffled poses are the images shuffled. Their mean PSNR has to lie below that of the
    images in order, in 95 % of the shuffles (a permutation test, one-sided), and by `FALL` on
    average.
    """
    drawn, frames = (x.flatten(1).float() for x in (images, truth))
    errors = torch.cdist(drawn, frames).double().square() / frames.shape[1]
    score = 10 * (255**2 / errors.clamp_min(1e-3)).log10()
    own = float(score.diagonal().mean())
    generator = torch.Generator().manual_seed(len(score))
    every = torch.arange(len(score))
    orders = [torch.randperm(len(score), generator=generator) for _ in range(SHUFFLES)]
    shuffled = torch.stack([score[order, every].mean() for order in orders])
    chance = (1 + int((shuffled >= own).sum())) / (1 + SHUFFLES)
    if chance > LEVEL or own - float(shuffled.mean()) < FALL:
        raise ContractError(
            "G7",
            f"declared conditional = true, but the scores do not fall when the poses of "
            f"{len(score)} frames are shuffled: PSNR {own:.2f} dB, shuffled "
            f"{float(shuffled.mean()):.2f} dB: make the image follow its pose",
        )


def check_generator(draw: Draw, poses: Tensor, seeds: Tensor, told: Declared) -> Tensor:
    """Check all that one process can tell (clauses G1 to G3 and G5 to G7); return the images.

    Args:
        draw: Asked for images some twenty times.
        poses: (N, 12), or (N, 13) with the phase of the beat; more than eight.
        seeds: (N,) int64.
        told: Both have to be declared (see `check_declared`).

    Raises:
        ContractError: the clause that is broken.
    """
    check_type(draw, poses, seeds)
    images = draw(poses, seeds)
    check_range(images)
    check_same(images, draw(poses, seeds), "G3")
    check_own_rows(draw, poses, seeds)
    check_seed(images, draw(poses, seeds + 1), bool(told.stochastic))
    check_pose(images, draw(other_poses(poses), seeds), bool(told.conditional))
    return images
