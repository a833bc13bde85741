"""A field between the frames of a scout, filled in by what train patients have in common."""

import copy
from dataclasses import dataclass
from typing import Any, Self

import torch
from torch import Tensor, nn
from torch.optim import Adam

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, parameters_to_pose
from racines_data.randomness import derive, uniform
from racines_data.store.frames import FrameStore
from racines_models.generators.scout_attention import ScoutAttention, ScoutAttentionConfig
from racines_models.networks.scene_field.echo import image_loss
from racines_models.networks.scouting import Painted, ScoutNetwork, Scouts
from racines_models.networks.volume import ABOUT, Prior, frame_of, gathered, looked_up
from racines_models.protocol import Run
from racines_models.training.episodes import Episode

FIT = 5
"""Random stream: the frames of a step of fitting."""
TOGETHER = 8
"""Frames that are painted in a step, at most; one of so many."""


@dataclass(frozen=True)
class ScoutFieldConfig(ScoutAttentionConfig):
    """Network and losses of `scout-attention`, and the field."""

    prior: int = 32
    """Channels of the prior at 20³ voxels; twice and four times as many at 10³. A multiple of 8."""
    channels: int = 16
    """Numbers of a voxel of the field. A multiple of 8."""
    fit: int = 20
    """Gradient steps that fit a patient's field to the scout, from what the prior says on."""
    fit_rate: float = 0.01
    """Learning rate of these steps (Adam)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for setting in ("prior", "channels"):
            width = getattr(self, setting)
            if width < 8 or width % 8:
                raise RacinesError(f"scout-field.{setting}: {width}: a multiple of 8")
        if self.fit < 0 or self.fit_rate <= 0:
            raise RacinesError("scout-field: fit is 0 or more, fit_rate is above 0")


class FieldNetwork(nn.Module):
    """A prior that fills in the field, and a painter that looks into it and into near frames."""

    def __init__(self, config: ScoutFieldConfig) -> None:
        super().__init__()
        self.prior = Prior(config.prior, config.channels)
        self.painter = ScoutNetwork(config.width, config.frames, config.channels, ABOUT)

    def forward(
        self, scouts: Scouts, owner: Tensor, pose: Pose, field: Tensor, home: Pose
    ) -> Painted:
        """Paint (B,) poses of G patients in turn, equally many of each.

        `field` is (G, channels, 40, 40, 40), as `prior` returns it, in the frames (G,) `home`.
        """
        more = looked_up(field, home, pose, self.painter.cells, scouts.pixel[owner])
        return self.painter(scouts, owner, pose, more)


class ScoutField(ScoutAttention):
    """Paints slices of a field that a patient's scout and the prior make together."""

    name = "scout-field"
    Config = ScoutFieldConfig
    title = "Scout field"
    summary = "A 3-D network fills in the volume between the scout's frames; slices look into it."
    source = "after Peng et al., Convolutional Occupancy Networks, 2020, on top of scout-attention"
    memory_format = torch.contiguous_format  # the other order is for images alone
    limits = (
        "draws nothing before it is adapted to a scout",
        "looks into the scout at 64×64 pixels, and fills in voxels of 5 mm",
        "draws the expected image: speckle of a place that no frame shows is smooth",
        "what it fills in is what train patients have there, which need not be the patient's",
    )
    config: ScoutFieldConfig  # pyright: ignore[reportIncompatibleVariableOverride]

    shown: Tensor | None = None
    """(P, 9, 40, 40, 40) float16 of all cases that it learns from, while it learns."""
    field: Tensor | None = None
    """(1, channels, 40, 40, 40) of the patient that it is adapted to."""

    def untrained(self) -> dict[str, nn.Module]:
        """Return the one network."""
        return {"painter": FieldNetwork(self.config)}

    def prepare(self, store: FrameStore) -> None:
        """Look at all scouts once: how large a pixel is, and what each voxel shows."""
        super().prepare(store)
        assert self.cases is not None
        rows = torch.arange(len(self.cases.lit), device=self.cases.lit.device)
        self.shown = torch.cat([gathered(self.cases.of(row)).half() for row in rows.split(1)])

    def learn(self, store: FrameStore, run: Run) -> dict[str, Any]:
        """Learn to fill in and to paint."""
        try:
            return super().learn(store, run)
        finally:
            self.cases = self.shown = None

    def expect(self, painter: nn.Module, scouts: Scouts, batch: Episode) -> Painted:
        """Return the expected images of a step, of the fields of its patients."""
        assert isinstance(painter, FieldNetwork) and self.shown is not None
        field = painter.prior(self.shown[batch.cases].float())
        pose = parameters_to_pose(batch.parameters)
        return painter(scouts, batch.owner, pose, field, frame_of(scouts.poses))

    def adapt(self, images: Tensor, parameters: Tensor, seed: int) -> Self:
        """Return it with a field fitted to a patient's scout (see `Adapting`); weights stay."""
        other = super().adapt(images, parameters, seed)
        scouts, _ = other.met()
        with torch.no_grad():
            field = self.net("painter").eval().prior(gathered(scouts))
        other.field = other.fitted_field(field, seed)
        return other

    def fitted_field(self, field: Tensor, seed: int) -> Tensor:
        """Fit a field to frames of the scout, each painted without itself and its neighbours."""
        painter, device = self.net("painter").eval(), field.device
        scouts, frames = self.met()
        if device.type != "cpu":
            # There gradients of a look-up are summed in no fixed order.
            painter, frames = copy.deepcopy(painter).cpu(), frames.cpu()
            scouts, field = scouts.on("cpu"), field.cpu()
        poses, count = Pose(*(part[0] for part in scouts.poses)), len(frames)
        size = min(TOGETHER, count // TOGETHER)
        owner = torch.zeros(size, dtype=torch.int64, device=field.device)
        field = field.requires_grad_()
        optimizer = Adam([field], self.config.fit_rate)
        for step in range(self.config.fit):
            order = uniform(derive(torch.tensor([seed]), FIT, step), count)[0].argsort()
            rows = order[:size].to(field.device)
            others = torch.ones(count, dtype=torch.bool)
            for beside in (-1, 0, 1):
                others[(order[:size] + beside).clamp(0, count - 1)] = False
            rest = scouts.without(~others)
            asked = Pose(*(part[rows] for part in poses))
            with torch.enable_grad():
                painted = painter(rest, owner, asked, field, frame_of(scouts.poses))
                ssim, error = image_loss(painted.mean, frames[rows].float() / 255.0)
                loss = (1.0 - ssim) + 4.0 * error
            (field.grad,) = torch.autograd.grad(loss, field)
            optimizer.step()
        return field.detach().to(device)

    def foresee(self, pose: Pose) -> Painted:
        """Return the expected images at (B,) poses of the patient that it is adapted to."""
        scouts, _ = self.met()
        owner = torch.zeros(len(pose.position), dtype=torch.int64, device=pose.position.device)
        return self.net("painter")(scouts, owner, pose, self.field, frame_of(scouts.poses))
