"""Reading every row of a config once, in parallel, for all checks that look at rows.

    shards ──> pieces of whole trajectories ──> workers: decode, check, digest, signature ──> Survey

A trajectory may cross shards: it belongs to the shard in which it begins.
"""

import json
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from hashlib import blake2b
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from torch import Tensor

from racines_data.digest import trajectory_digest
from racines_data.engines.local import LocalEngine
from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE
from racines_data.manifest import config_manifest, is_turned, manifest_labels
from racines_data.progress import progress_bar
from racines_data.records import features_of, table_to_trajectory
from racines_data.schema import Trajectory
from racines_data.sources.base import Unit
from racines_data.sources.gate.bounds import Bounds, manifest_bounds
from racines_data.sources.gate.check import check_trajectory
from racines_data.store.frames import FrameStore
from racines_data.store.sweeps import run_edges, trajectories

WORTH_WORKERS = 8192  # frames from which starting worker processes costs less than they save
POOL = 8  # edge, in pixels, of the blocks whose means are an image's signature

_KEPT = (
    *("id", "session", "target_view", "phantom", "patient"),
    *("parameters", "timestamps", "views", "grades", "phases"),
)
_STORED = (
    *("images", "views", "parameters", "controls", "grades"),
    *("timestamps", "phases", "turns", "masks"),
)


@dataclass(frozen=True)
class Piece:
    """A run of whole trajectories of one split that begin in one shard."""

    split: str
    names: Sequence[str]  # the shard, and those into which its last trajectory may go on
    first: int  # row of the shard at which they begin; an earlier shard's end before it
    stop: int  # past-the-last row, counted from the shard's beginning
    start: int  # row of the store at which they begin
    poses: bool = True  # whether the dataset has poses and times at all
    bounds: Bounds = Bounds()  # what the gate holds them to

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.stop - self.first


@dataclass(frozen=True)
class CheckedSweep:
    """What the checks need of one trajectory of T frames."""

    split: str
    id: str
    session: str
    target_view: str
    source: str
    phantom: int | None
    digest: str
    parameters: np.ndarray  # (T, 12) float32, NaN where absent
    timestamps: np.ndarray  # (T,) float64 seconds
    views: np.ndarray  # (T,) int64, -1 where unknown
    grades: np.ndarray  # (T,) float32, NaN where unknown
    predicted: np.ndarray  # (T, 2) float32, the grader's view and grade, NaN where absent
    hashes: np.ndarray  # (T,) uint64 of the pixels
    signatures: np.ndarray  # (T, 256) float16, block means of the image, gray levels
    patient: int | None = None  # seed
    phases: np.ndarray | None = None  # (T, 2) float64, of a patient
    mask_labels: tuple[int, ...] = ()  # the numbers that occur in its masks, if it has any
    faults: tuple[tuple[str, str], ...] = ()  # names of checks that do not hold here, and why

    def __len__(self) -> int:
        return len(self.timestamps)


@dataclass
class Survey:
    """All trajectories of a config, in order, and what is wrong with single ones."""

    config: str
    sweeps: list[CheckedSweep] = field(default_factory=list)
    faults: defaultdict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    """Reasons by check: `rows`, `store`."""

    def __len__(self) -> int:
        return sum(len(sweep) for sweep in self.sweeps)

    def column(self, name: str) -> np.ndarray:
        """Return an array of `CheckedSweep` of all frames, in order."""
        return np.concatenate([getattr(sweep, name) for sweep in self.sweeps])

    def each(self, name: str) -> np.ndarray:
        """Return an attribute of the trajectories, repeated for each frame."""
        values = np.array([getattr(sweep, name) for sweep in self.sweeps])
        return np.repeat(values, [len(sweep) for sweep in self.sweeps])

    def unless_faulty(self, check: str, said: str) -> str:
        """Return what is said, or raise the first fault found by a check, and how many more."""
        if found := self.faults[check]:
            more = f" (and {len(found) - 1} more trajectories)" if len(found) > 1 else ""
            raise RacinesError(found[0] + more)
        return said


def plan_pieces(root: Path, manifest: dict[str, Any], config: str) -> list[Piece]:
    """Divide the rows of a config, whose columns must be the schema's, into pieces for workers."""
    manifest = config_manifest(manifest, config)
    named = manifest["source"], manifest_labels(manifest), is_turned(manifest)
    schema = features_of(*named).arrow_schema
    pieces: list[Piece] = []
    known = manifest.get("poses", True), manifest_bounds(manifest)
    start = 0
    for split, names in manifest["configs"][config].items():
        for name in names:
            if not pq.read_schema(root / name).equals(schema):
                raise RacinesError(f"{name}: columns differ from the schema of `{config}`")
        tables = [pq.read_table(root / name, columns=["trajectory"]) for name in names]
        ends = np.cumsum([0, *map(len, tables)]).tolist()
        edges = np.array(run_edges(pa.concat_tables(tables)["trajectory"].to_numpy()) or [0])
        bounds = pairwise(edges[np.searchsorted(edges, ends)].tolist())
        for index, (first, stop) in enumerate(bounds):
            if first < stop:
                place = first - ends[index], stop - ends[index], start + first
                pieces.append(Piece(split, names[index:], *place, *known))
        start += ends[-1]
    return pieces


def survey(
    root: Path, manifest: dict[str, Any], config: str, workers: int = 1, progress: bool = False
) -> Survey:
    """Read all rows of a config in `workers` processes; small configs in this one."""
    pieces = plan_pieces(root, manifest, config)
    found = Survey(config)
    try:
        store = FrameStore(root, config)
    except RacinesError as error:
        store = None
        found.faults["store"].append(f"{error}")
    total = sum(piece.frames for piece in pieces)
    dataset = root, manifest_labels(manifest), store
    used = workers if total >= WORTH_WORKERS else 1
    read = LocalEngine(used).map(read_piece, dataset, pieces, remedy="with fewer --workers")
    with progress_bar(progress) as bar:
        task = bar.add_task(f"checking {config}", total=total)
        for piece, (sweeps, faults) in zip(pieces, read, strict=True):
            found.sweeps += sweeps
            found.faults["rows"] += faults
            for check, reason in (fault for sweep in sweeps for fault in sweep.faults):
                found.faults[check].append(reason)
            bar.advance(task, piece.frames)
    if store is not None and len(store) != total:
        found.faults["store"].append(f"the store has {len(store)} frames, the shards {total}")
    return found


def read_piece(
    dataset: tuple[Path, Sequence[str], FrameStore | None], piece: Piece
) -> tuple[list[CheckedSweep], list[str]]:
    """Read and check a piece; return its trajectories, and why others could not be read.

    The dataset is its folder, its labels, and its store if that is whole.
    """
    root, labels, store = dataset
    sweeps, faults = [], []
    stop = 0
    for rows in trajectories(root, piece.names):
        first, stop = stop, stop + len(rows)
        if first >= piece.stop:
            break
        if first < piece.first:
            continue
        try:
            trajectory = table_to_trajectory(rows)
        except (OSError, ValueError, SyntaxError, TypeError, pa.ArrowException) as error:
            name = rows["trajectory"][0].as_py()
            faults.append(f"trajectory {name}: its rows cannot be read: {error}")
            continue
        begin = piece.start + first - piece.first
        place = slice(begin, begin + len(rows))
        sweeps.append(_sweep(piece, rows, trajectory, labels, store, place))
    return sweeps, faults


def _sweep(
    piece: Piece,
    rows: pa.Table,
    trajectory: Trajectory,
    labels: Sequence[str],
    store: FrameStore | None,
    place: slice,
) -> CheckedSweep:
    faults = []
    try:
        _check_rows(rows, trajectory, labels, piece)
    except RacinesError as error:
        faults.append(("rows", f"{error}"))
    if store is not None and not _in_store(store, place, piece.split, trajectory):
        faults.append(("store", f"trajectory {trajectory.id} differs between store and shards"))
    hashes = (blake2b(image.tobytes(), digest_size=8).digest() for image in trajectory.images)
    predicted = [rows[name].cast(pa.float32()) for name in ("view_predicted", "grade_predicted")]
    return CheckedSweep(
        split=piece.split,
        **{name: getattr(trajectory, name) for name in _KEPT},
        source=_source(rows),
        digest=trajectory_digest(trajectory),
        predicted=np.stack([c.fill_null(np.nan).to_numpy() for c in predicted], -1),
        hashes=np.frombuffer(b"".join(hashes), "<u8"),
        signatures=signatures(trajectory.images),
        mask_labels=() if trajectory.masks is None else tuple(np.unique(trajectory.masks).tolist()),
        faults=tuple(faults),
    )


def _source(rows: pa.Table) -> str:
    """Return the source that the rows name; their schema has its names, and lists of them."""
    names = json.loads((rows.schema.metadata or {})[b"huggingface"])["info"]["features"]["source"]
    return names["names"][rows["source"][0].as_py()]


def _check_rows(
    rows: pa.Table, trajectory: Trajectory, labels: Sequence[str], piece: Piece
) -> None:
    unit = Unit(trajectory.id, trajectory.session, trajectory.target_view, len(trajectory))
    check_trajectory(trajectory, unit, labels, piece.poses, piece.bounds)
    where = f"trajectory {trajectory.id}"
    names = "session", "target_view", "phantom", "source", "patient"
    for name in names if trajectory.patient is not None else names[:-1]:
        if len(rows[name].unique()) > 1:
            raise RacinesError(f"{where}: {name} changes within it")
    if not np.array_equal(rows["frame"].to_numpy(), np.arange(len(rows))):
        raise RacinesError(f"{where}: frame numbers are not 0 to {len(rows) - 1} in order")


def _in_store(store: FrameStore, place: slice, split: str, trajectory: Trajectory) -> bool:
    start, stop = store.bounds(split)
    if place.stop > len(store) or not start <= place.start < stop:
        return False
    index = store.trajectory_index[place]
    patient = None if store.patients is None else store.patients[int(index[0])]
    return (
        store.trajectories[int(index[0])] == trajectory.id
        and patient == trajectory.patient
        and bool((index == index[0]).all())
        and all(_equal(getattr(store, name), getattr(trajectory, name), place) for name in _STORED)
    )


def _equal(stored: Tensor | None, read: np.ndarray | None, place: slice) -> bool:
    """Return whether the rows of a store are what was read; both may lack the column."""
    if stored is None or read is None:
        return stored is None and read is None
    return np.array_equal(stored[place].numpy(), read, equal_nan=True)


def signatures(images: np.ndarray) -> np.ndarray:
    """Return (T, 256) float16 means of 8x8 blocks of (T, 128, 128) uint8 images."""
    side = IMAGE_SIZE // POOL
    if images.shape[1:] != (IMAGE_SIZE, IMAGE_SIZE):
        return np.zeros((len(images), side * side), np.float16)
    blocks = images.reshape(-1, side, POOL, side, POOL)
    return blocks.mean((2, 4), dtype=np.float32).reshape(-1, side * side).astype(np.float16)
