"""The phantom: poses in, images, forces and truth out; batched, on one device."""

import copy
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, parameters_to_pose
from racines_data.imaging import check_parameters
from racines_data.phantom import acoustics, truth
from racines_data.phantom.anatomy import load_anatomy
from racines_data.phantom.config import BlockConfig, PhantomConfig, ProbeConfig, WorkspaceConfig
from racines_data.phantom.volume import bake
from racines_data.randomness import derive, sample_seeds
from racines_data.views import labels_of
from racines_data.world import Truth, Workspace, World

CHUNK = {"cuda": 2048}
"""Frames rendered at once by device type, else 64: bounds the memory of the polar grids (about 1 MB
a frame). On a GPU the launches of its kernels bound a smaller batch."""
VECTORS = 32  # rows that fill whole vectors of a CPU, whatever their columns


class Phantom(World):
    """A simulated block with an organ in it, a probe and a robot's contact; an `ImageSource`."""

    def __init__(self, config: PhantomConfig | None = None, device: torch.device | str = "cpu"):
        """Bake the block (seconds; share one instance through `shared_phantom`)."""
        self._config = config or PhantomConfig()
        self.device = torch.device(device)
        anatomy = load_anatomy(self.config.anatomy, self.config.anatomy_seed)
        volume = bake(anatomy, self.config.block)
        self._volume = volume._replace(
            packed=volume.packed.to(self.device), origin=volume.origin.to(self.device)
        )
        self._gel_attenuation = anatomy.tissues[0].attenuation
        self._set_probe()
        self._oracle = truth.make_oracle(anatomy, self.surface_height, self.device)
        self.views = tuple(view.name for view in anatomy.views)
        self.labels = labels_of(self.views)
        self.titles = {view.name: view.title for view in anatomy.views}
        self.home, self.wander = anatomy.home, anatomy.wander
        self.structures = tuple(structure.name for structure in anatomy.structures)
        self.workspace = workspace_of(self.config.workspace, self.config.block, self.device)

    @property
    def config(self) -> PhantomConfig:
        """Its settings."""
        return self._config

    @property
    def surface_height(self) -> float:
        """Height of the block's top, m."""
        return self.config.block.maximum[2]

    def _set_probe(self) -> None:
        probe = self.config.probe
        self._beams = acoustics.make_beams(probe, self._gel_attenuation, self.device)
        self._converter = acoustics.scan_converter(probe, self.device)

    def with_probe(self, probe: ProbeConfig) -> "Phantom":
        """Return this phantom under another probe or other settings; the baked block is shared."""
        other = copy.copy(self)
        other._config = replace(self.config, probe=probe)
        other._set_probe()
        return other

    def generate(self, parameters: Tensor, seed: int | Tensor) -> Tensor:
        """Return (B, 128, 128) uint8 images of (B, 12) parameters; see `ImageSource`.

        The pose decides the image, the seed its electronic noise; the force columns are not read.
        """
        parameters = check_parameters(parameters).to(self.device, torch.float32)
        seeds = sample_seeds(seed, len(parameters), self.device)
        return self.render(parameters_to_pose(parameters), seeds)

    def render(self, pose: Pose, seeds: Tensor) -> Tensor:
        """Return (B, 128, 128) uint8 images of poses on this device, unchecked."""
        if not len(seeds):
            return torch.zeros((0, 128, 128), dtype=torch.uint8, device=self.device)
        size = CHUNK.get(self.device.type, 64)
        chunks = zip(*(x.split(size) for x in (*pose, seeds)), strict=True)
        parts = [self._render_chunk(*chunk) for chunk in chunks]
        return parts[0] if len(parts) == 1 else torch.cat(parts)

    def envelope(self, pose: Pose, seeds: Tensor) -> Tensor:
        """Return the (B, beams, samples) envelope of one look, uncompressed; 1 is myocardium."""
        return next(self._looks(pose, seeds, self.coupling(pose))).sqrt()

    def _looks(self, pose: Pose, seeds: Tensor, coupling: Tensor) -> Iterator[Tensor]:
        """Yield the (B, beams, samples) echo power of each look."""
        probe = self.config.probe
        echoes = acoustics.sample_echoes(self._volume, self._beams, probe, pose)
        for look in range(probe.looks):
            field = acoustics.form_image(echoes, self._beams, look)
            noise = seeds if look == 0 else derive(seeds, look)
            field = acoustics.add_face(field, self._beams, probe, coupling, noise)
            yield acoustics.echo_power(field)

    def _render_chunk(self, position: Tensor, rotation: Tensor, seeds: Tensor) -> Tensor:
        pose = Pose(position, rotation)
        powers = self._looks(pose, seeds, self.coupling(pose))
        looks = [acoustics.log_compress(power, self.config.probe) for power in powers]
        return self._converter.convert(sum(looks[1:], looks[0]) / len(looks))

    def coupling(self, pose: Pose) -> Tensor:
        """Return (B, beams) acoustic coupling in 0-1."""
        return truth.coupling(pose, self.surface_height, self.config.probe)

    def wrench(self, pose: Pose, velocity: Tensor | None = None) -> Tensor:
        """Return (B, 6) force, N, and torque, N·m, at the wrist sensor in the probe's axes."""
        return truth.wrench(pose, velocity, self.surface_height, self.config.contact)

    def truth(self, parameters: Tensor) -> Truth:
        """Judge (B, 12) parameters with the oracle."""
        parameters = check_parameters(parameters).to(self.device, torch.float32)
        return self.judge(parameters_to_pose(parameters))

    def judge(self, pose: Pose) -> Truth:
        """Judge poses on this device, unchecked."""
        return self._oracle.judge(pose, self.config.probe, self.coupling(pose))

    def judge_alike(self, pose: Pose) -> Truth:
        """Judge poses so that a pose's truth ignores those beside it, to the last bit.

        A CPU's vector functions round otherwise than its scalar ones, which get what is left after
        the last full vector: so the rows are filled up to whole vectors.
        """
        count = len(pose.position)
        if self.device.type != "cpu" or count % VECTORS == 0:
            return self.judge(pose)
        rows = torch.arange(count + -count % VECTORS).remainder(count)
        truth = self.judge(Pose(pose.position[rows], pose.rotation[rows]))
        return Truth(*(each[:count] for each in truth))

    def target(self, view: str) -> Pose:
        """Return the nominal pose of a view, a batch of one; `RacinesError` if there is none."""
        if view not in self.views:
            raise RacinesError(f"unknown view {view!r}: choose one of {', '.join(self.views)}")
        row = self.views.index(view)
        return Pose(*(x[row : row + 1] for x in self._oracle.targets))


def workspace_of(config: WorkspaceConfig, block: BlockConfig, device: torch.device) -> Workspace:
    """Return where the probe may go over a block."""
    low = [*(edge + config.margin for edge in block.minimum[:2]), config.lowest]
    high = [*(edge - config.margin for edge in block.maximum[:2]), config.highest]
    lowest, highest = torch.tensor([low, high], device=device)
    return Workspace(lowest, highest, config.tilt_max, config.yaw_max)


_baked = lru_cache(maxsize=2)(Phantom)  # few: work on many hearts does not fill the memory


def shared_phantom(config: PhantomConfig | None = None, device: str = "cpu") -> Phantom:
    """Return the one phantom of a configuration and device in this process."""
    return _baked(config or PhantomConfig(), device)
