"""Flow matching on top of what a scout lets one expect: speckle that looks real, where it lies."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim import AdamW, Optimizer

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_data.geometry import Pose, parameters_to_pose
from racines_data.randomness import derive, normal, sample_seeds, uniform
from racines_data.store.frames import FrameStore
from racines_models.generators.flow import follow
from racines_models.generators.scout_attention import ScoutAttention, ScoutAttentionConfig
from racines_models.networks.batching import in_fixed_batches
from racines_models.networks.scouting import Painted, Scouts
from racines_models.networks.texturing import (
    CELLS,
    GRAYS,
    TextureNetwork,
    closest,
    deviations,
    folded,
    told_of,
    unfolded,
)
from racines_models.networks.unet import scales
from racines_models.protocol import Run
from racines_models.published.places import WEIGHTS, own_or_published, published
from racines_models.registry import PATIENTS, RUNS
from racines_models.training.checkpoint import repeat_folders
from racines_models.training.episodes import Episode, scouts_of
from racines_models.training.objective import Training, Update
from racines_models.weights import read_described

NOISE, TIME, DRAW = 1, 2, 3
"""Random streams: noise and time in training, noise at drawing."""
NUMBERS = GRAYS * CELLS * CELLS
DESCRIBED = "config.json"
LATEST = 0.05
"""Least share of the way still to go that an error is weighed by."""


@dataclass(frozen=True)
class ScoutFlowConfig(ScoutAttentionConfig):
    """Whose expected image it begins with, network, and steps of drawing."""

    grain: float = 1.0
    """Share of the drawn deviation that is added to the expected image: 1 is a sample; less is
    smoother, and nearer to the one true frame."""
    members: str = ScoutAttention.name
    """Run of scout-attention, by its name, trained here or published, or its folder. A training
    begins with the expected images of that of its own seed, whose `width` and `frames` it has."""
    texture: int = 32
    """Channels at 64×64 cells; twice as many at 32×32. A multiple of 8."""
    steps: int = 4
    """Steps from noise to image."""
    spacing: float = 1.5
    """1 - t falls as this power: 1 for equal steps, 2 for steps that shorten towards the end."""
    training: Training = Training(images=24_000, schedule="cosine", gradient_clip=1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.texture < 8 or self.texture % 8:
            raise RacinesError("scout-flow.texture: a multiple of 8, for group norm")
        if not 1 <= self.steps <= 16 or self.spacing <= 0:
            raise RacinesError("scout-flow: steps lie in 1-16 and spacing is above 0")


class ScoutFlow(ScoutAttention):
    """Draws, around the expected image of a patient's slice, what else may be seen there."""

    name = "scout-flow"
    Config = ScoutFlowConfig
    title = "Scout flow"
    summary = "A flow draws the speckle that is missing in what scout-attention expects."
    source = (
        "Liu et al., Flow Straight and Fast (rectified flow), 2023, on what a regression leaves, "
        "as in Whang et al., Deblurring via Stochastic Refinement, 2022"
    )
    stochastic = True
    fitted = ("painter",)
    limits = (
        "draws nothing before it is adapted to a scout",
        "begins with what scout-attention expects, whose errors of form it cannot mend",
        "speckle of a place that no frame shows looks right but is not that of the place",
    )
    config: ScoutFlowConfig  # pyright: ignore[reportIncompatibleVariableOverride]

    store: FrameStore | None = None
    """What it learns from, while it learns."""
    sha256: str | None = None
    """Of the weights of the painter that it goes on from, while it learns."""

    @property
    def identity(self) -> dict[str, Any]:
        """What is trained on what; what paints the expected image is a part of it."""
        return super().identity | {"painter": self.sha256}

    def untrained(self) -> dict[str, nn.Module]:
        """Return what paints the expected image, and the network of the flow."""
        return super().untrained() | {"texture": TextureNetwork(self.config.texture)}

    def prepare(self, store: FrameStore) -> None:
        """Look at all scouts once, and take over the painter of the same seed."""
        super().prepare(store)
        folder = painter_of(self.config.members, self.seed)
        painter = ScoutAttention.load(folder)
        for setting in ("width", "frames"):
            own, its = getattr(self.config, setting), getattr(painter.config, setting)
            if own != its:
                raise RacinesError(
                    f"scout-flow.{setting}: {own}, and that of {folder} is {its}: give {its}"
                )
        self.net("painter").load_state_dict(painter.net("painter").state_dict())
        self.net("painter").eval()
        self.sha256 = sha256_file(folder / "model.safetensors")

    def learn(self, store: FrameStore, run: Run) -> dict[str, Any]:
        """Learn what train patients' images show beside the expected ones."""
        self.store = store
        try:
            return super().learn(store, run)
        finally:
            self.store = self.cases = None

    def optimizers(self) -> dict[str, Optimizer]:
        """Return one AdamW."""
        return {"texture": AdamW(self.net("texture").parameters(), self.config.learning_rate)}

    def updates(self, nets: Mapping[str, nn.Module], batch: Episode) -> Iterator[Update]:
        """Yield one step: foresee the deviations from a point on the way to them.

        The path is that of `Flow`; the error is weighed so that the network's own output counts
        alike at all times.
        """
        assert self.cases is not None and self.store is not None
        cases, pose = self.cases.of(batch.cases), parameters_to_pose(batch.parameters)
        frames = scouts_of(self.store, batch.cases.cpu())[0].to(self.device).float() / 255.0
        with torch.no_grad():
            painted, told, about, lit = self._told(cases, frames, batch.owner, pose)
        truth = folded(
            (deviations(batch.images.float() / 255.0, painted.mean, painted.deviation) * lit)
            .unsqueeze(1)
        )  # fmt: skip
        time = uniform(derive(batch.seeds, TIME), 1)[:, 0]
        noise = normal(derive(batch.seeds, NOISE), NUMBERS).view_as(truth)
        at = time[:, None, None, None]
        foreseen = nets["texture"](noise.lerp(truth, at), time, told, about)
        weight = scales(time, 1.0)[1].clamp_min(LATEST).square().reciprocal()
        cells = folded(lit.unsqueeze(1).expand_as(painted.mean.unsqueeze(1)))
        error = ((foreseen.float() - truth).square() * cells).sum((1, 2, 3)) / cells.sum((1, 2, 3))
        loss = (error * weight).mean()
        yield Update("texture", loss, {"loss": loss})

    def draw(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        """Draw (B, 12) poses of the patient that it is adapted to."""
        known, frames = self.met()
        texture, config = self.net("texture").eval(), self.config
        shown = frames.unsqueeze(0).float() / 255.0

        def paint(parameters: Tensor, seeds: Tensor) -> Tensor:
            owner = torch.zeros(len(parameters), dtype=torch.int64, device=parameters.device)
            pose = parameters_to_pose(parameters)
            painted, told, about, lit = self._told(known, shown, owner, pose)

            def foresee(x: Tensor, time: Tensor, _: Tensor) -> Tensor:
                return texture(x, time, told, about)

            noise = normal(derive(seeds, DRAW), NUMBERS).view(-1, GRAYS, CELLS, CELLS)
            drawn = follow(foresee, noise, parameters, config.steps, "euler", config.spacing)
            image = painted.mean + config.grain * painted.deviation * unfolded(drawn) * lit
            return (image * 255.0).round().clamp(0, 255).to(torch.uint8)

        return in_fixed_batches(paint, parameters, sample_seeds(seed, len(parameters), self.device))

    def _told(
        self, scouts: Scouts, frames: Tensor, owner: Tensor, pose: Pose
    ) -> tuple[Painted, Tensor, Tensor, Tensor]:
        """Return the expected images, what the network is told of cells and images, the sector."""
        painted, lit = self.net("painter")(scouts, owner, pose), scouts.lit[owner]
        near = closest(scouts, frames, owner, pose)
        return painted, *told_of(painted, lit, scouts.pixel[owner], near), lit


def painter_of(members: str, seed: int) -> Path:
    """Return the folder of the training of a seed of a run of scout-attention.

    Args:
        members: name of a run, trained here or published, or its folder.
        seed: of the training.

    Raises:
        RacinesError: a run without that training.
    """
    folder = published(Path(members))
    if not (folder / DESCRIBED).is_file():
        own, kept = RUNS / PATIENTS / members, WEIGHTS / PATIENTS / members
        folder = own_or_published(own, kept, DESCRIBED)
    trainings = [folder, *repeat_folders(folder)]
    remedy = f"train it with `racines train generator {ScoutAttention.name} --tier patients`"
    seeds = [
        read_described(each, f"no expected images here; {remedy}")["seed"] for each in trainings
    ]
    if seed not in seeds:
        told = ", ".join(map(str, seeds))
        raise RacinesError(
            f"{folder}: has no training of seed {seed} (seeds {told}), from whose images one of "
            f"that seed goes on: {remedy}, its `repeats` so many, or give another seed"
        )
    return trainings[seeds.index(seed)]
