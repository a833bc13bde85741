"""The training store: one uncompressed Arrow IPC file, memory-mapped and served in whole batches.

One record batch with the images as FixedSizeBinary(16384) is one contiguous run of bytes, hence a
(N, 128, 128) tensor without a copy; nothing is decoded and no Python runs per frame. Plain
`binary` has 32-bit offsets, which overflow at 131,072 frames.
"""

import json
import mmap
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from torch import Tensor
from torch.utils.data import IterableDataset, get_worker_info

from racines_data import manifest
from racines_data.digest import check_files
from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE
from racines_data.manifest import ADDED, MULTI_PHANTOM, STORES
from racines_data.records import PIXELS
from racines_data.schema import CONTROLS, PARAMETERS, PHASES, TURNS
from racines_data.views import LABELS

SECTOR = 3.0
"""Degrees within which the turns about the apex of one heart are no independent ones."""


class Batch(NamedTuple):
    """Frames of one split."""

    images: Tensor
    """(B, 128, 128) uint8."""
    parameters: Tensor
    """(B, 12) float32, SI; forces NaN where absent. (B, 13) of recordings that know the phase of
    the beat, which is the last."""
    views: Tensor
    """(B,) int64 labels, -1 where unknown."""
    grades: Tensor
    """(B,) float32, NaN where unknown."""
    index: Tensor  # pyright: ignore[reportIncompatibleMethodOverride]
    """(B,) int64 rows of the store."""


class BatchMemory:
    """A few arrays that serve in turn.

    The system hands out fresh memory page by page, which takes as long as the copy into it. A
    tensor made from an array holds the array, and so does every view of the tensor, so that the
    array's count of holders tells whether a batch or a part of it is still in use.
    """

    def __init__(self, most: int = 4) -> None:
        """Keep `most` arrays; batches beyond them get memory of their own."""
        self._most = most
        self._arrays: list[np.ndarray] = []
        self._lock = threading.Lock()

    def get(self, rows: int, capacity: int) -> Tensor:
        """Return (rows, 2048) int64 memory with anything in it, out of one for `capacity` rows."""
        with self._lock:
            for place in range(len(self._arrays)):
                idle = _holders(self._arrays, place) == _IDLE
                if idle and len(self._arrays[place]) == capacity:
                    return torch.from_numpy(self._arrays[place][:rows])
            array = np.empty((capacity, PIXELS // 8), np.int64)
            self._arrays = [*self._arrays[-self._most + 1 :], array]
            return torch.from_numpy(array[:rows])


def _holders(arrays: list[np.ndarray], place: int) -> int:
    return sys.getrefcount(arrays[place])


_IDLE = _holders([np.empty(0)], 0)
"""Holders of an array that only its list holds; the number differs between Pythons."""


class FrameStore:
    """All frames of a config, memory-mapped. Rows are in the order train, validation, test.

    Raises:
        RacinesError: no dataset at `root`, or its store is damaged.
    """

    manifest: dict[str, Any]
    """The dataset's manifest: `version`, `source`, `digest`, `recipe_digest`, counts, files."""
    images: Tensor
    """(N, 128, 128) uint8, a view of the file. Writing to it changes this process's copy only."""
    parameters: Tensor
    """(N, 12) float32, SI; forces NaN where absent."""
    views: Tensor
    """(N,) int64 labels, -1 where unknown."""
    grades: Tensor
    """(N,) float32, 0-10, NaN where unknown."""
    timestamps: Tensor
    """(N,) float64 seconds; NaN where there is no clock."""
    controls: Tensor
    """(N, 6) float32, NaN where unknown."""
    trajectory_index: Tensor
    """(N,) int64, the row's place in `trajectories`."""
    frame: Tensor
    """(N,) int64, the row's number in its trajectory."""
    labels: tuple[str, ...] = LABELS
    """Names of the view labels, in label order; the last is `Random`."""
    trajectories: list[str]
    """Ids of the trajectories."""
    target_views: list[str]
    """Target view of each trajectory."""
    sessions: list[str]
    """Session of each trajectory."""
    phantoms: list[int | None]
    """Seed of each trajectory's simulated anatomy; absent for recordings."""
    patients: list[int] | None = None
    """Seed of each trajectory's patient; None where no patients are scanned."""
    phases: Tensor | None = None
    """(N, 2) float64 cardiac and respiratory phase in [0, 1), of patients; the second is NaN of a
    rotation about the apex."""
    turns: Tensor | None = None
    """(N, 2) float64 degrees, as `schema.TURNS`, of a rotation about the apex; else None."""
    masks: Tensor | None = None
    """(N, 128, 128) uint8, a view of the file: numbers of `mask_labels`; None without masks."""
    mask_labels: tuple[str, ...] | None = None
    """Names of the masks' labels by number; None without masks."""
    _as_recorded: bool = True

    def __init__(
        self, root: Path | str | None = None, config: str = "frames", verify: bool = False
    ) -> None:
        if config not in STORES:
            raise RacinesError(f"config {config!r} has no store: choose one of {', '.join(STORES)}")
        self.config = config
        self.root = manifest.default_root(root)
        self.manifest = manifest.config_manifest(manifest.read_manifest(self.root), config)
        self.labels = manifest.manifest_labels(self.manifest)
        files = self.manifest["files"]
        name = manifest.store_name(config)
        if name not in files:
            raise RacinesError(
                f"{self.root / 'manifest.json'}: names no {name}; {self._remedy(config)}"
            )
        hint = manifest.rebuild_hint(self.manifest)
        check_files(self.root, {name: files[name]}, hint, verify)
        try:
            self._read(self.root / name)
        except (pa.ArrowInvalid, KeyError, ValueError) as error:
            raise RacinesError(f"{self.root / name}: damaged ({error}); {hint}") from error

    def _remedy(self, config: str) -> str:
        if config in ADDED:
            return f"add it: racines data build --source {config} --out {self.root}"
        many = f" with data.{MULTI_PHANTOM}.hearts set" if config == MULTI_PHANTOM else ""
        return f"rebuild{many}"

    def __len__(self) -> int:
        return len(self.images)

    def measures(self) -> pa.Table:
        """Return who the patients are and what is true of their hearts, a row a patient.

        Volumes in ml at `phases` of the beat, lengths and diameters in mm, body in m, kg and m².

        Raises:
            RacinesError: a config without patients, or a damaged file.
        """
        name, files = manifest.measures_name(self.config), self.manifest["files"]
        if name not in files:
            raise RacinesError(f"{self.root}: config {self.config} has no patients to tell of")
        hint = manifest.rebuild_hint(self.manifest)
        check_files(self.root, {name: files[name]}, hint)
        return pq.read_table(self.root / name)

    def units(self, rows: Tensor) -> np.ndarray:
        """Return (N,) of what (N,) rows were drawn independently: their patient, or trajectory.

        Turns about the apex that lie within 3° are one: their frames are nearly the same.
        """
        if self.turns is not None:
            return (self.turns[rows, 0] / SECTOR).long().numpy()
        trajectory = self.trajectory_index[rows].numpy()
        return trajectory if self.patients is None else np.array(self.patients)[trajectory]

    def pathologies(self, rows: Tensor) -> np.ndarray:
        """Return the (N,) pathologies of (N,) rows' patients, as text.

        Raises:
            RacinesError: a config without patients, or a damaged file.
        """
        people = self.measures().select(["patient", "pathology"]).to_pydict()
        named = dict(zip(*people.values(), strict=True))
        return np.array([named[patient] for patient in self.units(rows).tolist()], dtype=str)

    @property
    def digest(self) -> str:
        """The content digest of this config."""
        return manifest.config_digest(self.manifest, self.config)

    def _read(self, path: Path) -> None:
        # A private mapping is writable without touching the file, as torch wants its memory.
        with path.open("rb") as file:
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
        whole = pa.py_buffer(mapped)
        table = pa.ipc.open_file(pa.BufferReader(whole)).read_all()

        def column(name: str, dtype: torch.dtype, *shape: int) -> Tensor:
            array = table[name].chunk(0)
            values = array.values if pa.types.is_fixed_size_list(array.type) else array
            start = values.buffers()[1].address - whole.address
            count = len(array) * int(np.prod(shape, initial=1))
            flat = torch.frombuffer(mapped, dtype=dtype, count=count, offset=start)
            return flat.view(len(array), *shape)

        self.images = column("image", torch.uint8, IMAGE_SIZE, IMAGE_SIZE)
        self._memory = BatchMemory()
        self._words = self.images.view(-1, PIXELS).view(torch.int64)
        self.parameters = column("parameters", torch.float32, len(PARAMETERS))
        self.controls = column("controls", torch.float32, len(CONTROLS))
        self.views = column("view", torch.int64)
        self.grades = column("grade", torch.float32)
        self.timestamps = column("timestamp", torch.float64)
        self.trajectory_index = column("trajectory", torch.int64)
        self.frame = column("frame", torch.int64)
        if "phases" in table.column_names:
            self.phases = column("phases", torch.float64, len(PHASES))
        if "turns" in table.column_names:
            self.turns = column("turns", torch.float64, len(TURNS))
        if "mask" in table.column_names:
            self.masks = column("mask", torch.uint8, IMAGE_SIZE, IMAGE_SIZE)
            self.mask_labels = tuple(self.manifest["mask_labels"])
        self._read_metadata(json.loads(table.schema.metadata[manifest.METADATA]))

    def _read_metadata(self, metadata: dict[str, Any]) -> None:
        self.trajectories, self.sessions, self.target_views = (
            list(names) for names in metadata["trajectories"]
        )
        self.phantoms = metadata.get("phantoms", [None] * len(self.trajectories))
        self._splits: dict[str, list[int]] = metadata["splits"]
        self.patients = metadata.get("patients")

    def split_indices(self, split: str) -> Tensor:
        """Return the (n,) int64 rows of a split, in order; empty if the split has none."""
        return torch.arange(*self.bounds(split))

    def bounds(self, split: str) -> tuple[int, int]:
        """Return the first and the past-the-last row of a split."""
        start, stop = self._splits[manifest.check_split(split)]
        return start, stop

    def order(self, split: str, seed: int) -> Tensor:
        """Return the (n,) int64 rows of a split, shuffled."""
        rows = self.split_indices(split)
        return rows[torch.randperm(len(rows), generator=torch.Generator().manual_seed(seed))]

    def batches(
        self,
        split: str,
        batch_size: int,
        seed: int,
        shuffle: bool = True,
        drop_last: bool = False,
        device: torch.device | str | None = None,
    ) -> Iterator[Batch]:
        """Yield one pass over a split in batches; the order depends on the seed alone.

        Without `shuffle` it is that of the store. `drop_last` leaves out a last batch that is not
        full. A batch is in main memory unless a device is named.

        Raises:
            RacinesError: no such split, or a batch size below one.
        """
        if batch_size < 1:
            raise RacinesError(f"batch_size {batch_size}: give one or more")
        rows = self.order(split, seed) if shuffle else self.split_indices(split)
        last = len(rows) - len(rows) % batch_size if drop_last else len(rows)
        for start in range(0, last, batch_size):
            index = rows[start : min(start + batch_size, last)]
            batch = self.take(index, self._memory.get(len(index), batch_size))
            yield batch if device is None else Batch(*(part.to(device) for part in batch))
            del batch  # so that its memory can serve again

    def take(self, index: Tensor, out: Tensor | None = None) -> Batch:
        """Return the frames of (B,) int64 rows; `out` is (B, 2048) int64 memory for the images."""
        # Rows of int64 words: a row copy moves 8 bytes at a time whatever the element.
        images = torch.index_select(self._words, 0, index, out=out).view(torch.uint8)
        images = images.view(-1, IMAGE_SIZE, IMAGE_SIZE)
        views, grades = (column.index_select(0, index) for column in (self.views, self.grades))
        return Batch(images, self.conditions(index), views, grades, index)

    @property
    def phased(self) -> bool:
        """Whether frames are conditioned on the phase of the beat: recordings that know it are.

        Simulated patients beat as well, and are conditioned on what their probe knows alone.
        """
        return self.turns is not None and self.phases is not None

    def conditions(self, rows: Tensor) -> Tensor:
        """Return (B, 12) parameters of (B,) rows, or (B, 13), the phase of the beat last."""
        parameters = self.parameters.index_select(0, rows)
        if not self.phased or self.phases is None:
            return parameters
        beat = self.phases[:, :1].index_select(0, rows).to(parameters.dtype)
        return torch.cat([parameters, beat], 1)

    def with_parameters(self, parameters: Tensor) -> Self:
        """Return a store of the same frames with other (N, 12) parameters, for this process."""
        other = object.__new__(type(self))
        vars(other).update(vars(self), parameters=parameters, _as_recorded=False)
        return other

    def __reduce__(self) -> tuple[type["FrameStore"], tuple[Path, str]]:
        # Another process opens the files, which hold what was recorded.
        if not self._as_recorded:
            raise TypeError(f"{self.root}: a store whose parameters were replaced stays here")
        return FrameStore, (self.root, self.config)


class BatchDataset(IterableDataset[Batch]):
    """One shuffled pass over a split in batches; every pass has an order of its own.

    Give it to a loader that does not batch again: `DataLoader(dataset, batch_size=None)`. The store
    alone serves batches faster than worker processes can hand them over; with workers, each takes
    its share of the batches.
    """

    def __init__(self, store: FrameStore, split: str, batch_size: int, seed: int = 0) -> None:
        """Serve `split` from `store`; `seed` and the number of the pass decide the order."""
        self.store, self.split, self.batch_size, self.seed = store, split, batch_size, seed
        self.epoch = 0
        """Number of the next pass; with worker processes, set it before each."""

    def __iter__(self) -> Iterator[Batch]:
        order, self.epoch = self.seed + self.epoch, self.epoch + 1
        worker = get_worker_info()
        number, workers = (worker.id, worker.num_workers) if worker else (0, 1)
        rows = self.store.order(self.split, order)
        for place, start in enumerate(range(0, len(rows), self.batch_size)):
            if place % workers == number:
                yield self.store.take(rows[start : start + self.batch_size])

    def __len__(self) -> int:
        start, stop = self.store.bounds(self.split)
        return -(-(stop - start) // self.batch_size)


def open_store(
    root: Path | str | None = None, config: str = "frames", verify: bool = False
) -> FrameStore:
    """Open the training store of a dataset (default: `data/racines`), of one of its configs.

    With `verify` the file is hashed again, also if it has not changed since an earlier check.
    """
    return FrameStore(root, config, verify)
