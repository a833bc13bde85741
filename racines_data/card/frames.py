"""What a card draws and counts: the columns of a training store that is not yet sealed."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from racines_data.imaging import IMAGE_SIZE
from racines_data.manifest import METADATA, manifest_labels
from racines_data.schema import CONTROLS, PARAMETERS, SPLITS


@dataclass(frozen=True)
class Frames:
    """The N frames of one store, in the order train, validation, test; images memory-mapped."""

    images: np.ndarray
    """(N, 128, 128) uint8."""
    parameters: np.ndarray
    """(N, 12) float32, SI; NaN where absent."""
    controls: np.ndarray
    """(N, 6) float32, NaN where absent."""
    views: np.ndarray
    """(N,) int64 labels, -1 where unknown."""
    grades: np.ndarray
    """(N,) float32, NaN where unknown."""
    timestamps: np.ndarray
    """(N,) float64 seconds."""
    trajectory: np.ndarray
    """(N,) int64 place in `trajectories`."""
    trajectories: list[str]
    target_views: list[str]
    """Target view of each trajectory."""
    phantoms: list[int | None]
    """Seed of each trajectory's anatomy; absent for recordings."""
    splits: dict[str, tuple[int, int]]
    """First and past-the-last row of each split."""
    labels: tuple[str, ...]
    """Names of the view labels."""

    @property
    def has_poses(self) -> bool:
        """Whether any frame has a position."""
        return bool(np.isfinite(self.parameters[:, 6:9]).any())

    def rows_of(self, trajectory: int) -> slice:
        """Return the rows of one trajectory; they are neighbours."""
        low, high = np.searchsorted(self.trajectory, (trajectory, trajectory + 1))
        return slice(int(low), int(high))


def read_frames(path: Path, manifest: Mapping[str, Any]) -> Frames:
    """Map a store by its path, whatever the manifest says of its files."""
    table = pa.ipc.open_file(pa.memory_map(str(path))).read_all()
    named = json.loads(table.schema.metadata[METADATA])
    trajectories, _, target_views = named["trajectories"][:3]

    def column(name: str, dtype: type, *shape: int) -> np.ndarray:
        array = table[name].chunk(0)
        buffer = (array.values if pa.types.is_fixed_size_list(array.type) else array).buffers()[1]
        flat = np.frombuffer(buffer, dtype, len(array) * int(np.prod(shape, initial=1)))
        return flat.reshape(len(array), *shape)

    return Frames(
        images=column("image", np.uint8, IMAGE_SIZE, IMAGE_SIZE),
        parameters=column("parameters", np.float32, len(PARAMETERS)),
        controls=column("controls", np.float32, len(CONTROLS)),
        views=column("view", np.int64),
        grades=column("grade", np.float32),
        timestamps=column("timestamp", np.float64),
        trajectory=column("trajectory", np.int64),
        trajectories=list(trajectories),
        target_views=list(target_views),
        phantoms=list(named.get("phantoms") or [None] * len(trajectories)),
        splits={name: tuple(named["splits"][name]) for name in SPLITS if name in named["splits"]},
        labels=manifest_labels(manifest),
    )
