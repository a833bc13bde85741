"""View synthesis: a learned voxel field of the scene, sampled along the probe's beams."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim import Adam, Optimizer

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, parameters_to_pose
from racines_data.randomness import derive, uniform
from racines_data.store.frames import FrameStore
from racines_models.generators.learned import NetworkGenerator
from racines_models.networks.layers import on_circle
from racines_models.networks.painting import OnnxModule
from racines_models.networks.scene_field.echo import MID, EchoDecoder, Place, image_loss
from racines_models.networks.scene_field.field import Layout, VoxelField, lay_out, neighbours
from racines_models.networks.scene_field.probe import Probe, ProbeGeometry
from racines_models.protocol import Run
from racines_models.sample import evenly
from racines_models.training.objective import TrainBatch, Training, Update

PICKS = 21
"""Random stream: which voxel of four gets a point's gradient."""
SURVEY = 1_500
"""Training frames whose beams say where voxels are needed."""
CHUNK = {"cpu": 8}
"""Images decoded at a time by device type, else all: their grids fit a CPU's caches."""


@dataclass(frozen=True)
class SceneFieldConfig:
    """Sizes, probe, rates and loop; lengths in metres."""

    probe: ProbeGeometry = ProbeGeometry()
    voxel: float = 0.001
    """Edge of a voxel of the fine field, which holds speckle and walls."""
    channels: int = 3
    """Amplitudes a fine voxel; two make a complex number, a third helps to find it."""
    coarse_voxel: float = 0.0025
    """Edge of a voxel of the coarse field: attenuation, brightness, directions."""
    coverage: float = 0.97
    """Share of all samples along beams whose place gets fine voxels."""
    spread: float = 0.1
    """Deviation of the fine field's random start. Echoes grow where they explain something: a
    start at 0.3 is noise that short runs do not get rid of."""
    field_rate: float = 3e-2
    coarse_rate: float = 1e-2
    decoder_rate: float = 3e-3
    calibration_rate: float = 2e-3
    """Adam's rate of shift (in mm), turn and scale (ten times less); 0 trusts the start."""
    offset_rate: float = 2e-2
    """Adam's rate of the samples' offsets out of the plane, mm; 0 leaves a flat image plane."""
    harmonics: int = 2
    """Waves of the beat that a voxel's numbers follow, where the data know its phase: a constant,
    and sine and cosine of each; 0 leaves a still scene."""
    smoothness: float = 0.0
    """Weight of the squared difference between neighbouring voxels (after the total variation of
    Plenoxels): what lies between frames that were looked at is filled from them; 0 leaves places
    that no training frame has looked at as they start."""
    pixel_weight: float = 4.0
    """Of the absolute error against 1 - SSIM."""
    training: Training = Training(
        batch_size=32, precision="fp32", ema=0.0, schedule="cosine", warmup_images=960
    )

    def __post_init__(self) -> None:
        if min(self.voxel, self.coarse_voxel) <= 0 or self.channels < 1:
            raise RacinesError("scene-field: voxel sizes and channels are above 0")
        if not 0.0 < self.coverage <= 1.0:
            raise RacinesError("scene-field.coverage: a share in (0, 1]")
        if min(self.field_rate, self.coarse_rate, self.decoder_rate) <= 0:
            raise RacinesError("scene-field: field_rate, coarse_rate and decoder_rate are above 0")
        if self.harmonics < 0:
            raise RacinesError("scene-field.harmonics: 0 or more")
        rates = self.calibration_rate, self.offset_rate
        if min(*rates, self.pixel_weight, self.spread, self.smoothness) < 0:
            raise RacinesError(
                "scene-field: rates, pixel_weight, spread and smoothness are 0 or more"
            )


class SceneField(NetworkGenerator[SceneFieldConfig]):
    """Learned voxels, what reaches them, and how their echoes add up."""

    name = "scene-field"
    Config = SceneFieldConfig
    title = "Scene field"
    summary = "A learned voxel field is sampled along the probe's beams and decoded to an image."
    source = "this benchmark (docs/scene-field.md); after Plenoxels, Fridovich-Keil et al., 2022"
    limits = (
        "knows one static scene: another organ, or a moving one, needs another field",
        "shows nothing where no training frame has looked",
        "draws the mean of what is random: electronic noise is left out",
    )

    fitted = ("place",)
    memory_format = torch.contiguous_format

    _layouts: tuple[Layout, Layout]
    _near: Sequence[Tensor] = ()
    """Neighbours of the rows of both fields, while it learns to be smooth."""

    def learn(self, store: FrameStore, run: Run) -> dict[str, Any]:
        """Lay the voxels where the training frames look, train, and round to eight bits."""
        config, poses = self.config, _training_poses(store)
        some = evenly(len(poses.position), SURVEY)
        with torch.no_grad():
            surveyed = Pose(poses.position[some], poses.rotation[some])
            looked = Probe(config.probe, self.metres).points(surveyed, coarse=True)
        points = looked.flatten(1).T.contiguous()
        filled = config.smoothness > 0
        fine = lay_out(points, 1e3 * config.voxel, config.coverage, filled)
        coarse = lay_out(points, 1e3 * config.coarse_voxel, 1.0, filled)
        self._layouts = fine, coarse
        self._near = [neighbours(each).to(self.device) for each in self._layouts if filled]
        metrics = super().learn(store, run)
        for name in ("fine", "coarse"):
            self.net(name).quantise()
        calibration = self.net("probe").calibration()
        if self.metres != 1.0:  # nothing is told in metres where the scale is not known
            del calibration["shift_m"]
        return metrics | {"calibration": calibration}

    def untrained(self) -> dict[str, nn.Module]:
        """Return the fields of the laid voxels, the probe, the decoder, and its view of a pose."""
        config, (fine, coarse), place = self.config, self._layouts, Place(self.phased)
        return {
            "fine": self._field(fine, config.voxel, config.channels, config.spread),
            "coarse": self._field(coarse, config.coarse_voxel, MID, 0.02),
            "probe": Probe(config.probe, self.metres),
            "decoder": EchoDecoder(config.probe.beams, config.probe.samples, place.width),
            "place": place,
        }

    def _field(self, layout: Layout, voxel: float, channels: int, spread: float) -> VoxelField:
        """Return a field of numbers, each with its waves of the beat, which start at zero."""
        field = VoxelField(layout, 1e3 * voxel, channels * self._waves, spread)
        with torch.no_grad():
            field.values[:, channels:] = 0.0
        return field

    @property
    def _waves(self) -> int:
        """Numbers for each that a still scene has."""
        return 1 + 2 * self.config.harmonics * self.phased

    def prepare(self, store: FrameStore) -> None:
        """Take the scales of the training poses."""
        self.net("place").fit(_training_poses(store))

    def averaged(self) -> tuple[str, ...]:
        """Name the decoder: the rate falls to zero, which serves the fields as an average would."""
        return ("decoder",)

    def optimizers(self) -> dict[str, Optimizer]:
        """Return one Adam with a rate for each part."""
        config, probe = self.config, self.net("probe")
        rates = (
            ([self.net("fine").values], config.field_rate),
            ([self.net("coarse").values], config.coarse_rate),
            (list(self.net("decoder").parameters()), config.decoder_rate),
            ([probe.shift], config.calibration_rate),
            ([probe.turn, probe.scale], 0.1 * config.calibration_rate),
            ([probe.offset], config.offset_rate),
        )
        groups = [{"params": weights, "lr": rate} for weights, rate in rates]
        return {"scene": Adam(groups, betas=(0.9, 0.99), eps=1e-12, fused=True)}

    def updates(self, nets: Mapping[str, nn.Module], batch: TrainBatch) -> Iterator[Update]:
        """Yield the one step of a batch."""
        config, count = self.config, len(batch.images)
        calibrates = max(config.calibration_rate, config.offset_rate) > 0
        live = -(-count // 2) if calibrates else 0  # half of the images are enough for it
        # A number in [0, 1) for each sample: one table, shifted by image.
        table = uniform(batch.seeds.new_zeros(1), self.net("probe").lateral.numel())
        picks = (table + uniform(derive(batch.seeds, PICKS), 1)).remainder(1.0).flatten()
        drawn = self._draw(nets, batch.parameters, picks, live)
        similarity, error = image_loss(drawn, batch.images.to(torch.float32) / 255.0)
        loss = 1.0 - similarity + config.pixel_weight * error
        for name, near in zip(("fine", "coarse"), self._near, strict=False):
            loss = loss + config.smoothness * self.net(name).roughness(near)
        yield Update("scene", loss, {"ssim": similarity, "error": error})

    def _draw(
        self,
        nets: Mapping[str, nn.Module] | nn.ModuleDict,
        parameters: Tensor,
        picks: Tensor | None = None,
        live: int = 0,
    ) -> Tensor:
        """Return (B, 128, 128) images of checked parameters, black 0, white 1, unclipped."""
        probe, (beams, samples) = self.net("probe"), self.net("probe").offset.shape
        pose = parameters_to_pose(parameters)
        points, moving = _points(probe, pose, live)
        fine = nets["fine"](points, picks, moving).view(-1, beams, samples, self._fine_width)
        points, moving = _points(probe, pose, live, coarse=True)
        coarse = nets["coarse"](points, None, moving)
        coarse = coarse.view(-1, beams // 2, samples // 2, MID * self._waves)
        beat = parameters[:, 12:] if self.phased else None
        fine, coarse = (self._now(each, beat) for each in (fine, coarse))
        inputs = fine, coarse, probe.directions(pose), self.net("place")(pose, beat)
        if torch.compiler.is_exporting():  # a loop over parts would fix the number of images
            return probe.image(nets["decoder"](*inputs))
        size = CHUNK.get(parameters.device.type, max(1, len(parameters)))
        parts = zip(*(each.split(size) for each in inputs), strict=True)
        return torch.cat([probe.image(nets["decoder"](*part)) for part in parts])

    @property
    def _fine_width(self) -> int:
        return self.config.channels * self._waves

    def _now(self, numbers: Tensor, beat: Tensor | None) -> Tensor:
        """Return the (B, L, S, C) numbers at (B, 1) phases of (B, L, S, W · C) with their waves."""
        if beat is None or self._waves == 1:
            return numbers
        each = torch.arange(1, self.config.harmonics + 1, device=beat.device)
        waves = torch.cat([torch.ones_like(beat), on_circle(beat * each)], 1)
        parts = numbers.unflatten(-1, (self._waves, -1))
        return (parts * waves[:, None, None, :, None]).sum(-2)

    def onnx_module(self) -> OnnxModule:
        """Return all of it, as one network of the pose."""
        return OnnxModule(_Still(self))

    def tensors(self) -> dict[str, Tensor]:
        """Return fields (eight bits a number once trained), probe, decoder and contact's scales."""
        if self.nets is None:
            return {}
        tensors = {}
        for name, net in self.nets.items():
            state = net.packed() if isinstance(net, VoxelField) else net.state_dict()
            tensors |= {f"{name}.{key}": value for key, value in state.items()}
        return tensors

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Take the fields and weights back."""
        parts: dict[str, dict[str, Tensor]] = {}
        for key, value in tensors.items():
            name, _, rest = key.partition(".")
            parts.setdefault(name, {})[rest] = value.to(self.device)
        self._layouts = _layout(parts["fine"]), _layout(parts["coarse"])
        self.nets = self.build().to(self.device)
        for name, net in self.nets.items():
            (net.unpack if isinstance(net, VoxelField) else net.load_state_dict)(parts[name])


class _Still(nn.Module):
    """A fitted scene field as a module of its parameters alone."""

    def __init__(self, field: SceneField):
        super().__init__()
        assert field.nets is not None
        self.nets, self._field = field.nets, (field,)  # in a tuple: no second set of parameters

    def forward(self, parameters: Tensor) -> Tensor:
        """Return (B, 128, 128) uint8 of (B, 12) parameters."""
        images = self._field[0]._draw(self.nets, parameters)
        return images.clamp(0.0, 1.0).mul(255.0).round().to(torch.uint8)


def _training_poses(store: FrameStore) -> Pose:
    return parameters_to_pose(store.parameters[store.split_indices("train")])


def _layout(packed: dict[str, Tensor]) -> Layout:
    rows = len(packed["values"]) if "values" in packed else packed["codes"].shape[:2].numel()
    return Layout(packed["origin"], packed["table"], rows)


def _points(probe: Probe, pose: Pose, live: int, coarse: bool = False) -> tuple[Tensor, int]:
    """Return (3, N) points, and how many of them, from the first images, have a gradient."""
    with torch.no_grad():
        points = probe.points(pose, coarse)
    if not live:
        return points.flatten(1), 0
    moving = probe.points(Pose(pose.position[:live], pose.rotation[:live]), coarse)
    return torch.cat([moving, points[:, live:]], 1).flatten(1), moving[0].numel()
