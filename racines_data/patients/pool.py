"""Many patients in one tensor: a batch whose rows are scanned on different hearts at once.

    voxels  | heart 0 and its tiles | heart 1 and its tiles | ...          19.9 MB each
    a row    = its heart's offset + the voxel under each sample

Poses are of the base frame; a heart's place is a rigid transform of the samples. What a row becomes
hangs on its own patient, pose, phase and seed alone, whatever else the pool or the batch holds.
"""

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from racines_data.geometry import Pose, rotate
from racines_data.patients import oracle
from racines_data.patients.bake import baked, recipe
from racines_data.patients.chest import Chest, breathing, cover, obstacles, shadows, undeform
from racines_data.patients.heart import LEVELS, Heart, make_heart, nominal_targets
from racines_data.patients.labels import CODES, shown
from racines_data.patients.measures import Measures, measure
from racines_data.patients.memory import MEMORY, available_memory, check_memory
from racines_data.patients.motion import (
    Dynamics,
    activation,
    all_stages,
    to_diastole,
    valve_stages,
)
from racines_data.patients.patches import unevenness
from racines_data.patients.patient import Patient
from racines_data.patients.placement import SURFACE, workspace
from racines_data.patients.population import draw_patient
from racines_data.patients.render import (
    convert,
    hear,
    make_scanner,
    picture,
    pixel_map,
    solid_table,
    spread,
)
from racines_data.patients.rhythm import Rhythm, phases, rhythm_of
from racines_data.patients.sampling import (
    NODE_BITS,
    base_nodes,
    coordinates,
    elevation_axis,
    make_grid,
    place_samples,
)
from racines_data.patients.settings import PROBE, Settings
from racines_data.patients.volume import HEART_SIZE
from racines_data.phantom import truth
from racines_data.phantom.config import ContactConfig
from racines_data.views import LABELS, VIEWS
from racines_data.world import Truth, Workspace

CHUNK = {"cuda": 1024}
"""Rows rendered at once by device type, else 64. On a GPU the launches of kernels bound a smaller
batch."""


class Pool:
    """Baked patients on one device, scanned in batches."""

    def __init__(
        self,
        seeds: Sequence[int | Patient],
        device: torch.device | str = "cpu",
        beating: bool = False,
        memory: int | None = MEMORY,
    ):
        """Bake patients, or fetch them from the cache.

        Args:
            seeds: of the patients, in the order of their rows; or patients, as `lie_anew` makes
                several of one, whose voxels are then held once.
            device: where voxels lie and rows are drawn.
            beating: whether nominal poses have to be good over the whole beat; the phase that is
                given with a row moves its heart in any case.
            memory: bytes that the voxels may take, where the machine has them; None: no picture is
                asked for, so that none are held.

        Raises:
            RacinesError: no seeds, a seed of no split, or more hearts than fit, before any is
                baked.
        """
        self.patients: tuple[Patient, ...] = tuple(
            each if isinstance(each, Patient) else draw_patient(int(each)) for each in seeds
        )
        self.seeds = tuple(patient.seed for patient in self.patients)
        self._baked = {self._recipe(patient): patient for patient in self.patients}
        self.device, self._memory = torch.device(device), memory
        self._check_memory(None if memory is None else available_memory(self.device))
        self.beating = beating
        self.views, self.labels = VIEWS, LABELS
        self.shown: tuple[str, ...] = VIEWS
        self.provenance: dict[str, Any] | None = None
        self.surface_height = SURFACE
        self.hearts = [self._heart(patient) for patient in self.patients]
        self._join(self.hearts)
        self._grid = make_grid(self.device)
        self._scanner = make_scanner(self._grid, self.device)

    def __len__(self) -> int:
        return len(self.seeds)

    @cached_property
    def _voxels(self) -> Tensor:
        """All hearts' voxels, baked when they are first looked at: who asks for poses waits not."""
        self._check_memory(available_memory(self.device))
        whole = len(self._baked) * HEART_SIZE
        voxels = torch.empty(whole, dtype=torch.int64, device=self.device)
        for row, patient in enumerate(self._baked.values()):
            voxels[row * HEART_SIZE : (row + 1) * HEART_SIZE] = self._bake(patient).to(self.device)
        return voxels

    def _check_memory(self, free: int | None) -> None:
        check_memory(len(self._baked), self._memory, free)

    # What hearts are, how they are baked and how they move; a pool of others says so for itself.

    def _heart(self, patient: Patient) -> Heart:
        return make_heart(patient, self.beating)

    def _recipe(self, patient: Patient) -> str:
        return recipe(patient)

    def _bake(self, patient: Patient) -> Tensor:
        return baked(patient)

    def _to_diastole(self, organ: Tensor, rows: Tensor, phase: Tensor) -> Tensor:
        """Return where (B, …, 3) points of the organ frame were at end diastole."""
        return to_diastole(organ, self._dynamics.rows(rows), self._act(rows, phase))

    def _organ_marks(self, rows: Tensor, phase: Tensor) -> Tensor:
        """Return the (B, S, 3) landmarks in the organ frame, mm."""
        level = self._act(rows, phase).clamp(0.0, 1.0) * (LEVELS - 1)
        below = level.floor().clamp_max(LEVELS - 2).long()
        tracks = self._tracks.flatten(0, 1)
        first, second = (tracks.index_select(0, rows * LEVELS + below + i) for i in (0, 1))
        return torch.lerp(first, second, (level - below).view(-1, 1, 1))

    def _join(self, hearts: list[Heart]) -> None:
        """Stack what differs from patient to patient."""
        device = self.device

        def joined(name: str) -> list[Tensor]:
            rows = [getattr(heart, name) for heart in hearts]
            return [torch.cat(parts).to(device) for parts in zip(*rows, strict=True)]

        self._settings = Settings(*joined("settings"))
        self._chest, self._dynamics = Chest(*joined("chest")), Dynamics(*joined("dynamics"))
        tapes = [rhythm_of(each.motion, each.seed) for each in self.patients]
        self._rhythm = Rhythm(*(torch.stack(t).to(device) for t in zip(*tapes, strict=True)))
        self._tracks = torch.stack([heart.tracks for heart in hearts]).to(device)
        self._radii, self._weights = hearts[0].radii.to(device), hearts[0].weights.to(device)
        self._targets = nominal_targets(hearts).to(device)
        pixels = [pixel_map(each.examination.half_angle) for each in self.patients]
        maps = (torch.stack(each).to(device) for each in zip(*pixels, strict=True))
        self._pixels, self._nearest, self._covered = maps
        stages = all_stages()
        self._solid = solid_table(stages).to(device)
        labels = [[shown(code, (a, b, c)) for code in range(CODES)] for a, b, c in stages.tolist()]
        self._shown = torch.tensor(labels, dtype=torch.uint8, device=device)
        # Offsets of more than 2^31 voxels need wider integers.
        kind = torch.int32 if len(self._baked) * HEART_SIZE < 2**31 else torch.int64
        held = list(self._baked)
        places = torch.tensor([held.index(self._recipe(patient)) for patient in self.patients])
        self._offsets = places.mul_(HEART_SIZE).to(device, kind)

    @property
    def workspace(self) -> Workspace:
        """Where the probe may go, whoever lies there."""
        return workspace(self.device)

    def phase(self, rows: Tensor, time: Tensor, hold_breath: bool = False) -> Tensor:
        """Return the (B, 2) cardiac and respiratory phases of rows at (B,) seconds."""
        return phases(self._rhythm, rows, time, hold_breath)

    def _phase(self, rows: Tensor, phase: Tensor | None) -> Tensor:
        if phase is None:  # end diastole, breathed out
            return torch.zeros((len(rows), 2), dtype=torch.float64, device=self.device)
        return phase.to(self.device, torch.float64)

    # --- pictures ---------------------------------------------------------------------------------

    def render(
        self, pose: Pose, rows: Tensor, phase: Tensor | None = None, seeds: Tensor | None = None
    ) -> Tensor:
        """Return (B, 128, 128) uint8 images.

        Args:
            pose: (B,) of the probe, base frame.
            rows: (B,) int64, which of the pool's patients.
            phase: (B, 2) as `phase` gives; None: end diastole, breathed out.
            seeds: (B,) int64 of blood's speckle and electronic noise; None: zeros.
        """
        seeds = torch.zeros_like(rows) if seeds is None else seeds
        images = [self._render(*part) for part in self._parts(pose, rows, phase, seeds)]
        return torch.cat(images) if images else self._empty()

    def _empty(self) -> Tensor:
        return torch.zeros((0, 128, 128), dtype=torch.uint8, device=self.device)

    def _parts(
        self, pose: Pose, rows: Tensor, phase: Tensor | None, seeds: Tensor
    ) -> Iterator[tuple[Pose, Tensor, Tensor, Tensor]]:
        size = CHUNK.get(self.device.type, 64)
        position, rotation = (each.to(self.device, torch.float64) for each in pose)
        phase = self._phase(rows, phase)
        for start in range(0, len(rows), size):
            part = slice(start, start + size)
            yield Pose(position[part], rotation[part]), rows[part], phase[part], seeds[part]

    def _render(self, pose: Pose, rows: Tensor, phase: Tensor, seeds: Tensor) -> Tensor:
        settings, chest = self._settings.rows(rows), self._chest.rows(rows)
        nodes = self._nodes(pose, rows, phase, settings, chest)
        samples = place_samples(nodes, elevation_axis(pose, settings), self._grid)
        solid = self._solid.index_select(0, self._stages(rows, phase))
        found = obstacles(pose, settings.half_angle, chest)
        uneven = cover(pose, settings.half_angle, chest)
        shadow = shadows(found, uneven, settings.step, PROBE.samples)
        at = self._offsets.index_select(0, rows)
        scanner = self._scanner
        patches = unevenness(nodes[:, :3] * 2.0**-NODE_BITS, settings.waves, settings.steps)
        heard = settings._replace(along=settings.along + spread(patches, scanner))
        echoes = hear(self._voxels, at, samples, solid, heard, shadow, scanner, seeds)
        coupling = truth.coupling(pose, SURFACE, PROBE).float()
        polar = picture(echoes, coupling, settings, scanner, seeds)
        pixels, covered = (x.index_select(0, rows) for x in (self._pixels, self._covered))
        return convert(polar, pixels, covered, settings, scanner, seeds)

    def _nodes(
        self, pose: Pose, rows: Tensor, phase: Tensor, settings: Settings, chest: Chest
    ) -> Tensor:
        """Return the (B, 5, 13, 19) coordinates of the polar grid's nodes."""
        base = undeform(base_nodes(pose, self._grid, settings), pose.position * 1e3)
        origin = settings.origin + breathing(chest, phase[:, 1])
        organ = rotate(settings.axes[:, None, None], base - origin[:, None, None])
        return coordinates(base, self._to_diastole(organ, rows, phase), settings)

    def _act(self, rows: Tensor, phase: Tensor) -> Tensor:
        return activation(phase[:, 0], self._dynamics.kick.index_select(0, rows))

    def _stages(self, rows: Tensor, phase: Tensor) -> Tensor:
        return valve_stages(phase[:, 0], self._dynamics.kick.index_select(0, rows))

    def mask(self, pose: Pose, rows: Tensor, phase: Tensor | None = None) -> Tensor:
        """Return (B, 128, 128) uint8 labels as `labels.LABELS`, of the slice's middle plane."""
        masks = [self._mask(*part[:3]) for part in self._parts(pose, rows, phase, rows)]
        return torch.cat(masks) if masks else self._empty()

    def _mask(self, pose: Pose, rows: Tensor, phase: Tensor) -> Tensor:
        settings, chest = self._settings.rows(rows), self._chest.rows(rows)
        nodes = self._nodes(pose, rows, phase, settings, chest)
        samples = place_samples(nodes, None, self._grid)
        at = self._offsets.index_select(0, rows).view(-1, 1, 1)
        index = samples.voxel + at
        packed = self._voxels.index_select(0, index.flatten()).view(torch.uint8)
        code = packed.view(len(rows), -1, 8)[..., 7] & (CODES - 1)
        code = code.masked_fill(samples.air.flatten(1) < 0, 0).long()
        label = self._shown.index_select(0, self._stages(rows, phase)).gather(1, code)
        label = torch.cat([label, label.new_zeros(len(rows), 1)], 1)  # outside the sector
        return label.gather(1, self._nearest.index_select(0, rows)).view(-1, 128, 128)

    # --- truth ------------------------------------------------------------------------------------

    def judge(self, pose: Pose, rows: Tensor, phase: Tensor | None = None) -> Truth:
        """Return what is true at (B,) poses of rows' patients, moved by the phase."""
        return oracle.judge(*self._scored(pose, rows, phase))

    def judge_beat(self, pose: Pose, rows: Tensor, moments: Sequence[float]) -> Truth:
        """Return the same at M cardiac phases, breathed out: all is (M, B, …).

        Two moments take hardly longer than one, since what lies before the heart stays.
        """
        count, many = len(moments), len(rows)
        phase = torch.zeros(count, many, 2, dtype=torch.float64, device=self.device)
        phase[..., 0] = phase.new_tensor(moments).unsqueeze(1)
        marks = self._marks(rows.repeat(count), phase.flatten(0, 1)).unflatten(0, (count, many))
        pose = _double(pose)
        every = marks.transpose(0, 1).flatten(1, 2)
        seen = self._look(pose, rows, every, self._radii.repeat(count))
        visibility = seen.visibility.unflatten(1, (count, -1)).transpose(0, 1)
        targets = self._nominal(rows, self._phase(rows, None))
        score = oracle.scores(pose, visibility, self._weights, targets)
        return oracle.judge(score, visibility, seen.clarity)

    def scores(self, pose: Pose, rows: Tensor, phase: Tensor | None = None) -> Tensor:
        """Return (B, V) in 0-1: how completely the views are shown, which grades rise from 0.5."""
        return self._scored(pose, rows, phase)[0]

    def _scored(
        self, pose: Pose, rows: Tensor, phase: Tensor | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return (B, V) scores, (B, S) visibility and (B,) clarity."""
        pose, phase = _double(pose), self._phase(rows, phase)
        seen = self._look(pose, rows, self._marks(rows, phase), self._radii)
        targets = self._nominal(rows, phase)
        score = oracle.scores(pose, seen.visibility, self._weights, targets)
        return score, seen.visibility, seen.clarity

    def _look(self, pose: Pose, rows: Tensor, marks: Tensor, radii: Tensor) -> oracle.Sight:
        settings, chest = self._settings.rows(rows), self._chest.rows(rows)
        return oracle.look(pose, marks, radii, settings, chest)

    def _marks(self, rows: Tensor, phase: Tensor) -> Tensor:
        """Return the (B, S, 3) landmarks of moved hearts, mm, base frame."""
        organ = self._organ_marks(rows, phase)
        axes = self._settings.axes.index_select(0, rows).transpose(-1, -2).unsqueeze(1)
        origin = self._settings.origin.index_select(0, rows)
        origin = origin + breathing(self._chest.rows(rows), phase[:, 1])
        return rotate(axes, organ) + origin.unsqueeze(1)

    def _nominal(self, rows: Tensor, phase: Tensor) -> Pose:
        position, rotation = (each.index_select(0, rows) for each in self._targets)
        sway = breathing(self._chest.rows(rows), phase[:, 1]) * 1e-3
        return Pose(position + sway.unsqueeze(1), rotation)

    def targets(self, rows: Tensor, phase: Tensor | None = None) -> Pose:
        """Return the (B, V) nominal poses, which go with the breath but not with the beat."""
        pose = self._nominal(rows, self._phase(rows, phase))
        return Pose(pose.position.float(), pose.rotation.float())

    def measures(self, row: int) -> Measures:
        """Return the true volumes, lengths and diameters of a patient; takes a second."""
        return measure(self.hearts[row])

    def pixel_size(self, rows: Tensor) -> Tensor:
        """Return (B,) mm, the side of a pixel of rows' patients."""
        return self._settings.rows(rows).pixel_size()

    def wrench(self, pose: Pose, velocity: Tensor | None = None) -> Tensor:
        """Return (B, 6) force, N, and torque, N·m, in the probe's axes; the skin is everyone's."""
        return truth.wrench(pose, velocity, SURFACE, ContactConfig())


def _double(pose: Pose) -> Pose:
    return Pose(*(each.double() for each in pose))
