"""A heart of one's own among the patients: it lies, is examined and breathes as one of them does.

    of its own           voxels, landmarks, views, and how it moves
    of the patient       place in the chest, ribs and lung, tissues, scanner, heart rate and breath

Windows for the views that it lacks are laid by a simulated heart of its length and widths. A view
that it lacks is never seen in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.geometry import Pose
from racines_data.own.warp import Warp
from racines_data.patients.form import LIVER, Point, Shape, shape_of
from racines_data.patients.heart import Heart, Seen, assemble
from racines_data.patients.labels import LV, MYOCARDIUM, RV, RV_WALL
from racines_data.patients.landmarks import view_specs
from racines_data.patients.motion import SYSTOLE
from racines_data.patients.patient import Form, Patient
from racines_data.patients.placement import BEYOND, SURFACE, lay
from racines_data.patients.volume import VOXEL, centres
from racines_data.phantom.anatomy import ViewSpec
from racines_data.phantom.saved import Saved, provenance_of, read_saved, saved_folder
from racines_data.phantom.truth import nominal_pose
from racines_data.views import VIEWS

ABSENT = "absent"
"""A landmark that is nowhere: what views have to show that the heart lacks."""
FAR = (0.0, 0.0, -1e4)  # where that is, mm
HEIGHTS = (0.35, 0.45), (0.15, 0.3)
"""Shares of the LV's length between which its width and that of the RV are taken."""
_USUAL = Form(
    ventricle=50.2, length=85.0, oval=0.92, oval_turn=0.0, waviness=0.0, septum=9.5, wall=8.9,
    right=34.5, right_length=1.0, left_atrium=36.0, right_atrium=38.0, root=33.5, outflow=23.0,
    papillary=1.0,
)  # fmt: skip
"""The mean man of `patients.population`, where a heart of one's own does not say."""


@dataclass(frozen=True)
class OwnHeart:
    """A heart of one's own, read from its folder."""

    told: dict[str, Any]
    codes: Tensor
    """(BOX, BOX, BOX) uint8 structures, `racines_data.patients.labels`."""
    warp: Warp | None
    """None for one that stands still."""
    centres: Tensor
    """(S, 3) float64 landmarks at the first phase, mm, the absent one last."""
    radii: Tensor
    """(S,) mm."""
    names: tuple[str, ...]
    views: dict[str, ViewSpec]
    shape: Shape
    """A simulated heart of its length and widths."""
    surface: Tensor
    """(M, 3) centres of its walls' voxels, mm."""

    @property
    def shown(self) -> tuple[str, ...]:
        """The patients' views that it has."""
        return tuple(view for view in VIEWS if view in self.views)

    @property
    def phases(self) -> int:
        """Phases of a beat."""
        return int(self.told["heart"]["phases"])

    def moment(self, phase: Tensor) -> Tensor:
        """Return (B,) moments in [0, phases) at (B,) cardiac phases: systole ends with theirs."""
        end, last = float(self.told["heart"]["end_systole"]), float(self.phases)
        filling = end + (phase - SYSTOLE) / (1.0 - SYSTOLE) * (last - end)
        return torch.where(phase < SYSTOLE, phase / SYSTOLE * end, filling).clamp(0.0, last - 1e-9)


def open_heart(name: str) -> OwnHeart:
    """Read a heart of one's own by its folder or name.

    Raises:
        RacinesError: no such phantom, or one that is no heart.
    """
    return _heart_of(_saved(name))


def heart_provenance(name: str) -> dict[str, Any]:
    """Return what records say of a heart of one's own.

    Raises:
        RacinesError: no such phantom.
    """
    return provenance_of(_saved(name).told)


def _saved(name: str) -> Saved:
    # Among patients no built-in anatomy is meant: one may call its folder "heart".
    folder = saved_folder(name)
    if folder is None:
        raise RacinesError(
            f"phantom {name!r}: no such folder, here or in data/phantoms: make one with "
            "racines phantom from-mesh"
        )
    return read_saved(folder)


def _heart_of(saved: Saved) -> OwnHeart:
    told = saved.told
    if told["heart"] is None:
        raise RacinesError(
            f"{saved.folder}: has no section heart, so it lies in the block and not among "
            "patients: leave out --tier, and name it as the phantom's anatomy"
        )
    table = torch.zeros(len(told["parts"]) + 1, dtype=torch.uint8)
    for number, part in enumerate(told["parts"], 1):
        table[number] = part["structure"]
    codes = table[saved.tensors["labels"].long()]
    warp = None
    if told["heart"]["warp"]:
        low = told["heart"]["warp"]["low"]
        warp = Warp(saved.tensors["back"], (low[0], low[1], low[2]))
    marks = told["structures"]
    places = [*([1e3 * x for x in centre] for _, centre, _ in marks), list(FAR)]
    radii = [*(1e3 * radius for *_, radius in marks), 1.0]
    walls = torch.isin(codes, torch.tensor([MYOCARDIUM, RV_WALL, LV, RV], dtype=torch.uint8))
    surface = centres(walls.nonzero())
    shape = _shape_of(codes, surface @ surface.new_tensor(LIVER))
    views = {each["name"]: ViewSpec(**each) for each in told["views"]}
    return OwnHeart(
        told, codes, warp, torch.tensor(places, dtype=torch.float64),
        torch.tensor(radii, dtype=torch.float64), (*(name for name, *_ in marks), ABSENT), views,
        shape, surface,
    )  # fmt: skip


def _shape_of(codes: Tensor, below: Tensor) -> Shape:
    """Return a simulated heart of a heart's length and widths, over a liver that it lies on."""
    cavity, right = (centres((codes == each).nonzero()) for each in (LV, RV))
    length = float(cavity[:, 2].max())
    (low, high), (base, top) = HEIGHTS
    band = (cavity[:, 2] > low * length) & (cavity[:, 2] < high * length)
    area = float(band.sum()) * float(np.prod(VOXEL)) / ((high - low) * length)
    form = replace(_USUAL, ventricle=2.0 * (area / np.pi) ** 0.5, length=length)
    if len(right):
        level = (right[:, 2] > base * length) & (right[:, 2] < top * length)
        middle = level & (right[:, 1].abs() < 5.0)
        if bool(middle.any()):
            across = right[middle, 0]
            form = replace(form, right=float(across.max() - across.min()))
    # As deep in the diaphragm as the simulated hearts lie (`patients.form`).
    return replace(shape_of(form), diaphragm=float(below.max()) - 7.0)


def lie(own: OwnHeart, patient: Patient, beating: bool) -> Heart:
    """Lay a heart of one's own where a patient's would lie, and search its nominal poses."""

    def top(up: Point) -> float:
        return float((own.surface @ own.surface.new_tensor(up)).max()) + 1.5  # the pericardium

    placement = lay(top, patient)
    specs = [own.views.get(view.name, view) for view in view_specs(own.shape)]
    poses = [nominal_pose(view, placement.axes, placement.origin, SURFACE) for view in specs]
    start = Pose(*(torch.stack(parts) for parts in zip(*poses, strict=True)))
    tracks, end = _tracks(own), int(own.told["heart"]["end_systole"])
    moments = (0, end // 2, end) if beating and own.warp is not None else (0,)
    seen = Seen(tracks, own.radii, _weights(own), moments)
    away = (placement.to_base(own.centres) - start.position.unsqueeze(1)).norm(dim=-1)
    far = max(
        float(away[VIEWS.index(view), own.names.index(name)])
        for view in own.shown for name, _ in own.views[view].structures
    )  # fmt: skip
    depth = round((far + BEYOND * 1e-3) * (1.0 + patient.examination.margin), 6)
    return assemble(patient, own.shape, placement, start, depth, seen)


def _weights(own: OwnHeart) -> Tensor:
    weights = torch.zeros((len(VIEWS), len(own.names)), dtype=torch.float64)
    for row, view in enumerate(VIEWS):
        shows: Sequence[tuple[str, float]] = ((ABSENT, 1.0),)
        if view in own.views:
            shows = own.views[view].structures
        for name, weight in shows:
            weights[row, own.names.index(name)] = weight
    return weights / weights.sum(1, keepdim=True)


def _tracks(own: OwnHeart) -> Tensor:
    """Return the (P, S, 3) landmarks at all phases, organ frame, mm."""
    every = own.centres.expand(own.phases, -1, -1)
    if own.warp is None:
        return every.clone()
    return own.warp.now(every, torch.arange(own.phases, dtype=torch.float64))
