"""Patients who have one heart of one's own, each in a chest and under a scanner of their own."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from functools import lru_cache

import torch
from torch import Tensor

from racines_data.own.heart import OwnHeart, lie, open_heart
from racines_data.own.warp import Warp
from racines_data.patients.bake import bake_labels
from racines_data.patients.heart import Heart
from racines_data.patients.measures import (
    PHASES,
    Measures,
    calipers,
    count_volumes,
    labels_at,
)
from racines_data.patients.memory import MEMORY
from racines_data.patients.patient import Patient
from racines_data.patients.pool import Pool
from racines_data.phantom.saved import provenance_of


class OwnPool(Pool):
    """A pool whose patients have the heart of a phantom of one's own in place of theirs."""

    def __init__(
        self,
        phantom: str,
        seeds: Sequence[int | Patient],
        device: torch.device | str = "cpu",
        beating: bool = False,
        memory: int | None = MEMORY,
    ):
        """Lay the heart in the patients' chests.

        Args:
            phantom: folder or name, with a section heart.
            seeds: of the patients as whom it lies; as of `Pool`, as are the others.
            device: see `Pool`.
            beating: see `Pool`; a heart of one phase stands still in any case.
            memory: see `Pool`.

        Raises:
            RacinesError: no such phantom or one that is no heart, and as of `Pool`.
        """
        self.own: OwnHeart = open_heart(phantom)
        super().__init__(seeds, device, beating, memory)
        told = self.own.told
        self.shown, self.provenance = self.own.shown, provenance_of(told)
        self._warp = _on(self.own.warp, self.device)

    def _heart(self, patient: Patient) -> Heart:
        return _laid(self.own.told["digest"], patient, self.beating, _Held(self.own))

    def _recipe(self, patient: Patient) -> str:
        parts = {"heart": self.own.told["digest"], "seed": patient.seed}
        parts |= {"tissues": asdict(patient.tissues), "fat": patient.chest.fat}
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()

    def _bake(self, patient: Patient) -> Tensor:
        return bake_labels(patient, self.own.codes, self.own.shape)

    def _to_diastole(self, organ: Tensor, rows: Tensor, phase: Tensor) -> Tensor:
        if self._warp is None:
            return organ
        return self._warp.before(organ, self.own.moment(phase[:, 0]))

    def _organ_marks(self, rows: Tensor, phase: Tensor) -> Tensor:
        moment, count = self.own.moment(phase[:, 0]), self.own.phases
        first = moment.floor()
        below = first.long()
        tracks = self._tracks.flatten(0, 1)
        now, then = (
            tracks.index_select(0, rows * count + (below + i).remainder(count)) for i in (0, 1)
        )
        return torch.lerp(now, then, (moment - first).view(-1, 1, 1))

    def measures(self, row: int) -> Measures:
        """Return the true volumes, lengths and diameters, counted in the moved voxels."""
        return _measured(self.own.told["digest"], _Held(self.own))


def make_pool(
    seeds: Sequence[int | Patient],
    device: torch.device | str = "cpu",
    beating: bool = False,
    memory: int | None = MEMORY,
    phantom: str = "",
) -> Pool:
    """Return a pool of patients with their own hearts, or all with that of a phantom.

    Raises:
        RacinesError: as of `OwnPool`.
    """
    if phantom:
        return OwnPool(phantom, seeds, device, beating, memory)
    return Pool(seeds, device, beating, memory)


class _Held:
    """A heart beside the key by which it is remembered; all of one key are alike."""

    def __init__(self, own: OwnHeart) -> None:
        self.own = own

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Held)

    def __hash__(self) -> int:
        return 0


@lru_cache(maxsize=512)
def _laid(digest: str, patient: Patient, beating: bool, held: _Held) -> Heart:
    return lie(held.own, patient, beating)


def _on(warp: Warp | None, device: torch.device) -> Warp | None:
    return None if warp is None else warp._replace(back=warp.back.to(device))


@lru_cache(maxsize=4)
def _measured(digest: str, held: _Held) -> Measures:
    own = held.own
    phases = [i / PHASES for i in range(PHASES)]
    moments = [float(own.moment(torch.tensor([p], dtype=torch.float64))) for p in phases]
    end = float(own.told["heart"]["end_systole"])

    def labels(points: Tensor, moment: float) -> Tensor:
        if own.warp is not None:
            when = torch.tensor([moment], dtype=torch.float64)
            points = own.warp.before(points.unsqueeze(0), when)[0]
        return labels_at(points, own.codes)

    counted = [count_volumes(lambda p, m=m: labels(p, m)) for m in (*moments, end)]
    parts = {name: tuple(each[name] for each in counted) for name in counted[0]}
    first, last = (calipers(lambda p, m=m: labels(p, m)) for m in (0.0, end))
    base, apex = 0.0, own.shape.form.length
    ends = torch.tensor([[0.0, 0.0, base], [0.0, 0.0, apex]], dtype=torch.float64)
    moved = ends
    if own.warp is not None:
        moved = own.warp.now(ends.unsqueeze(0), torch.tensor([end], dtype=torch.float64))[0]
    nothing = float("nan")
    return Measures(
        phases=(*phases, 0.35),
        volumes=parts,
        ejection_fraction=_emptied(parts["lv"]),
        right_ejection_fraction=_emptied(parts["rv"]),
        lv_diameter=(first[0], last[0]),
        lv_length=(apex, float((moved[1] - moved[0]).norm())),
        wall=(first[1], last[1]),
        septum=(first[2], last[2]),
        left_atrium=nothing,
        root=nothing,
        right=own.shape.form.right,
    )


def _emptied(volumes: tuple[float, ...]) -> float:
    return 1.0 - volumes[-1] / volumes[0] if volumes[0] else float("nan")
