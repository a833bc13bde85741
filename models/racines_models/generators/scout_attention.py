"""Attention over the frames of a patient's scout: each cell of an image looks where it lies."""

import copy
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import torch
from torch import Tensor, nn
from torch.optim import AdamW, Optimizer

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, parameters_to_pose
from racines_data.patients.scouts import POSES
from racines_data.store.frames import FrameStore
from racines_models.adapting import check_scout
from racines_models.generators.learned import NetworkGenerator
from racines_models.networks.batching import in_fixed_batches
from racines_models.networks.scale import pixel_side
from racines_models.networks.scene_field.echo import image_loss
from racines_models.networks.scouting import (
    NEAR,
    Painted,
    ScoutNetwork,
    Scouts,
    shrink,
    texture,
)
from racines_models.pictures import write_strip
from racines_models.protocol import Run
from racines_models.sample import evenly
from racines_models.training.episodes import (
    Episode,
    EpisodeCourse,
    asked_of,
    cases_of,
    scouts_of,
)
from racines_models.training.objective import Training, Update
from racines_models.training.trainer import train

LOOKED_AT = 4
"""Validation patients that are looked at while it trains."""
SHOWN = 8
"""Images of each in a sheet."""


@dataclass(frozen=True)
class ScoutAttentionConfig:
    """Network, losses and what is added to the expected image."""

    width: int = 32
    """Channels at 32×32 cells; twice as many at 16×16. A multiple of 8."""
    frames: int = 10
    """Nearest frames of the scout that a slice looks into, 4 or more."""
    learning_rate: float = 2e-3
    grain: float = 0.0
    """Share of the deviation about the expected image that is added as speckle, with the grain of
    the scout's nearest frame: more of it looks real, and is further from the one true frame."""
    training: Training = Training(images=36_000, schedule="cosine", gradient_clip=1.0)

    def __post_init__(self) -> None:
        if self.width < 8 or self.width % 8:
            raise RacinesError("scout-attention.width: a multiple of 8, for group norm")
        if self.frames < NEAR or self.learning_rate <= 0:
            raise RacinesError("scout-attention: frames are 4 or more, learning_rate is above 0")
        if not 0.0 <= self.grain <= 1.0:
            raise RacinesError("scout-attention.grain lies in [0, 1]")


class ScoutAttention(NetworkGenerator[ScoutAttentionConfig]):
    """Paints the slice that the scout's frames leave between them; learned on train patients."""

    name = "scout-attention"
    Config = ScoutAttentionConfig
    title = "Scout attention"
    summary = "Each cell gathers, by attention, what the scout's frames show where it lies."
    source = (
        "after Wang et al., IBRNet: Learning Multi-View Image-Based Rendering, 2021, with slices "
        "in place of rays"
    )
    scout = 2 * NEAR
    limits = (
        "draws nothing before it is adapted to a scout",
        "looks into the scout at 64×64 pixels",
        "draws the expected image: speckle of a place that no frame shows is smooth",
        "finds out from the scout how large a pixel is, and may be wrong by a few hundredths",
    )

    known: Scouts | None = None
    """Of the patient that it is adapted to."""
    frames: Tensor | None = None
    """(S, 128, 128) uint8, the patient's scout."""
    cases: Scouts | None = None
    """Of all cases of the store that it learns from, while it learns."""

    def untrained(self) -> dict[str, nn.Module]:
        """Return the one network."""
        return {"painter": ScoutNetwork(self.config.width, self.config.frames)}

    def prepare(self, store: FrameStore) -> None:
        """Look at all scouts once: how large a pixel is in each."""
        held = [known(*(x[0] for x in scouts_of(store, case.view(1))))
                for case in torch.cat([cases_of(store, "train"), cases_of(store, "validation")])
                ]  # fmt: skip
        images, poses, lit, pixel = zip(*held, strict=True)
        pose = Pose(*(torch.cat(part) for part in zip(*poses, strict=True)))
        cases = Scouts(torch.cat(images), pose, torch.cat(lit), torch.cat(pixel))
        self.cases = cases.on(self.device)

    def learn(self, store: FrameStore, run: Run) -> dict[str, Any]:
        """Learn to paint the poses of train patients from their scouts."""
        cases_of(store, "train")
        self.nets = self.build()
        self.prepare(store)
        self.nets.to(self.device)

        def look(seen: int, folder: Path) -> Mapping[str, float]:
            figures = self._look(store, folder / "samples" / f"{seen:09d}.png")
            return {f"validation/{key}": figures[key] for key in ("ssim", "psnr", "mae")}

        training = self.config.training
        course = EpisodeCourse(store, training, run.seed, self.device, look)
        learner: Any = self
        return train(learner, store, training, run, course)

    def look_back(self, store: FrameStore, run: Run) -> dict[str, Any]:
        """Draw poses of validation patients after the fit."""
        return self._look(store, run.folder / "samples.png")

    @torch.no_grad()
    def _look(self, store: FrameStore, path: Path) -> dict[str, Any]:
        """Adapt to some validation patients; write true and drawn images of each, rows in turn."""
        split = "validation" if len(store.split_indices("validation")) else "train"
        cases = cases_of(store, split)[:LOOKED_AT].tolist()
        rows, found = [], []
        for case in cases:
            images, parameters = (x[0] for x in scouts_of(store, torch.tensor([case])))
            truth, asked = asked_of(store, case)
            drawn = self.adapt(images, parameters, 0).generate(asked, 0)
            error = drawn.float() - truth.float()
            ratio = 10.0 * (255.0**2 / error.square().mean((1, 2)).clamp_min(1e-3)).log10()
            found.append([
                float(image_loss(drawn.float() / 255.0, truth.float() / 255.0)[0]),
                float(ratio.mean()), float(error.abs().mean()),
            ])  # fmt: skip
            some = evenly(len(truth), SHOWN)
            rows += [truth[some], drawn[some]]
        write_strip(path, rows, gap=0)
        means = torch.tensor(found).mean(0).tolist()
        figures = dict(zip(("ssim", "psnr", "mae"), means, strict=True))
        return {"split": split, "n": len(cases) * POSES, **figures}

    def optimizers(self) -> dict[str, Optimizer]:
        """Return one AdamW."""
        return {"painter": AdamW(self.net("painter").parameters(), self.config.learning_rate)}

    def updates(self, nets: Mapping[str, nn.Module], batch: Episode) -> Iterator[Update]:
        """Yield one step: likeness of the expected image, then how far the frame is from it."""
        assert self.cases is not None
        of_step = self.cases.of(batch.cases)
        truth = batch.images.float() / 255.0
        painted = self.expect(nets["painter"], of_step, batch)
        ssim, error = image_loss(painted.mean, truth)
        rest = ((truth - painted.mean.detach()) / painted.deviation).square()
        lit = of_step.lit[batch.owner]
        spread = ((0.5 * rest + painted.deviation.log()) * lit).sum() / lit.sum()
        loss = (1.0 - ssim) + 4.0 * error + 0.05 * spread
        yield Update("painter", loss, {"ssim": ssim, "error": error, "spread": spread})

    def expect(self, painter: nn.Module, scouts: Scouts, batch: Episode) -> Painted:
        """Return the expected images of a step, whose patients' `scouts` are known."""
        return painter(scouts, batch.owner, parameters_to_pose(batch.parameters))

    def adapt(self, images: Tensor, parameters: Tensor, seed: int) -> Self:
        """Return it with a patient's scout before its eyes (see `Adapting`); nothing is trained."""
        check_scout(images, parameters, self.scout, self.name)
        other = copy.copy(self)
        other.known = known(images.cpu(), parameters.cpu()).on(self.device)
        other.frames = images.to(self.device)
        return other

    def met(self) -> tuple[Scouts, Tensor]:
        """Return what is known of the patient that it is adapted to, and the scout's frames."""
        if self.known is None or self.frames is None:
            raise RacinesError(
                f"{self.name} has no scout of this patient: call adapt(images, parameters, seed), "
                "or score it with --tier patients"
            )
        return self.known, self.frames

    def foresee(self, pose: Pose) -> Painted:
        """Return the expected images at (B,) poses of the patient that it is adapted to."""
        scouts, _ = self.met()
        owner = torch.zeros(len(pose.position), dtype=torch.int64, device=pose.position.device)
        return self.net("painter")(scouts, owner, pose)

    def draw(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        """Paint (B, 12) poses of the patient that it is adapted to."""
        held, frames = self.met()
        self.net("painter").eval()
        grains = texture(frames.float() / 255.0) * held.lit if self.config.grain else None

        def paint(parameters: Tensor) -> Tensor:
            painted = self.foresee(parameters_to_pose(parameters))
            image = painted.mean
            if grains is not None:
                image = image + self.config.grain * painted.deviation * grains[painted.nearest]
            return (image * 255.0).round().clamp(0, 255).to(torch.uint8)

        return in_fixed_batches(paint, parameters)


def known(images: Tensor, parameters: Tensor) -> Scouts:
    """Return what is known of one patient from (S, 128, 128) images and (S, 12) parameters."""
    pose, small = parameters_to_pose(parameters.float()), shrink(images)
    lit = images.amax(0).gt(0).float()
    pixel = torch.tensor([pixel_side(small, pose)])
    poses = Pose(pose.position.unsqueeze(0), pose.rotation.unsqueeze(0))
    return Scouts(small.unsqueeze(0), poses, lit.unsqueeze(0), pixel)
