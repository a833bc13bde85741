"""What the judge learns from: images with masks, by patient."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.manifest import check_split
from racines_data.store.frames import FrameStore
from racines_models.provenance import dataset_card


class Masked(NamedTuple):
    """Frames with their masks."""

    images: Tensor
    """(B, 128, 128) uint8."""
    masks: Tensor
    """(B, 128, 128) uint8, numbers of the set's labels."""


@dataclass(frozen=True)
class MaskSet:
    """N images with masks; their splits share no patient."""

    images: Tensor
    """(N, 128, 128) uint8."""
    masks: Tensor
    """(N, 128, 128) uint8, numbers of `labels`; may be memory-mapped."""
    patients: np.ndarray
    """(N,) of any type that sorts: whose heart it is, the unit of intervals."""
    splits: Mapping[str, Tensor]
    """(n,) int64 rows by split."""
    labels: tuple[str, ...]
    """Names by number, `background` first."""
    card: Mapping[str, Any] = field(default_factory=dict)
    """What names the data: source, version, digests."""
    strata: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """(N,) names by kind, such as `view` or `pathology`, that figures are told apart by."""

    def __post_init__(self) -> None:
        """Refuse what does not fit together.

        Raises:
            RacinesError: lengths or shapes that differ, or a patient of two splits.
        """
        if self.images.shape != self.masks.shape or len(self.patients) != len(self.images):
            told = f"{tuple(self.images.shape)}, {tuple(self.masks.shape)}, {len(self.patients)}"
            raise RacinesError(f"images, masks and patients differ in number or shape: {told}")
        seen: dict[Any, str] = {}
        for split, rows in self.splits.items():
            for patient in np.unique(self.patients[rows.numpy()]).tolist():
                if seen.setdefault(patient, split) != split:
                    both = f"{seen[patient]} and {split}"
                    raise RacinesError(f"patient {patient} is in {both}: split by patient")

    def split_indices(self, split: str) -> Tensor:
        """Return the (n,) int64 rows of a split; empty if it has none."""
        return self.splits.get(check_split(split), torch.empty(0, dtype=torch.int64))

    def take(self, index: Tensor) -> Masked:
        """Return the frames of (B,) int64 rows."""
        return Masked(self.images[index], self.masks[index])

    @classmethod
    def of(cls, store: FrameStore) -> "MaskSet":
        """Take the frames of a store that has masks: `masks`, and `mask_labels` that name them.

        Raises:
            RacinesError: a dataset without masks.
        """
        masks, labels = store.masks, store.mask_labels
        if masks is None or labels is None or store.patients is None:
            raise RacinesError(
                f"{store.root}: config {store.config} has no masks; add one that has: "
                f"racines data build --source patients --out {store.root}"
            )
        rows = torch.arange(len(store))
        seeds, sick = store.units(rows), store.pathologies(rows).tolist()
        views = [store.labels[view] if view >= 0 else "unknown" for view in store.views.tolist()]
        return cls(
            store.images,
            masks,
            seeds,
            {name: store.split_indices(name) for name in ("train", "validation", "test")},
            tuple(labels),
            dataset_card(store),
            {"view": views, "pathology": sick},
        )
