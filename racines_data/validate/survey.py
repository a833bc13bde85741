"""Reading every row of a config once, in parallel, for all checks that look at rows.

    shards ──> pieces of whole trajectories ──> workers: decode, check, digest, signature ──> Survey

A trajectory may cross shards: it belongs to the shard in which it begins.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from racines_data.build.staging import worker_pool
from racines_data.errors import RacinesError
from racines_data.manifest import manifest_labels
from racines_data.progress import progress_bar
from racines_data.records import features_of
from racines_data.store.frames import FrameStore
from racines_data.store.sweeps import run_edges
from racines_data.validate.rows import CheckedSweep, Piece, read_piece

WORTH_WORKERS = 8192
"""Frames from which starting worker processes costs less than they save."""
_state: tuple[Path, Sequence[str], FrameStore | None] | None = None  # a worker's own


@dataclass
class Survey:
    """All trajectories of a config, in order, and what is wrong with single ones."""

    config: str
    sweeps: list[CheckedSweep] = field(default_factory=list)
    faults: dict[str, list[str]] = field(default_factory=dict)
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

    def raise_faults(self, check: str) -> None:
        """Raise the first reason found for a check, if any, and say how many more there are."""
        found = self.faults.get(check, [])
        if found:
            more = f" (and {len(found) - 1} more trajectories)" if len(found) > 1 else ""
            raise RacinesError(found[0] + more)


def plan_pieces(root: Path, manifest: dict[str, Any], config: str) -> list[Piece]:
    """Divide the rows of a config into pieces for the workers.

    Raises:
        RacinesError: a shard whose columns are not those of the schema.
    """
    schema = features_of(manifest["source"], manifest_labels(manifest)).arrow_schema
    pieces: list[Piece] = []
    start = 0
    for split, names in manifest["configs"][config].items():
        for name in names:
            if not pq.read_schema(root / name).equals(schema):
                raise RacinesError(f"{name}: columns differ from the schema of `frames`")
        tables = [pq.read_table(root / name, columns=["trajectory"]) for name in names]
        ends = np.cumsum([0, *map(len, tables)]).tolist()
        edges = np.array(run_edges(pa.concat_tables(tables)["trajectory"].to_numpy()) or [0])
        bounds = pairwise(edges[np.searchsorted(edges, ends)].tolist())
        for index, (first, stop) in enumerate(bounds):
            if first < stop:
                place = first - ends[index], stop - ends[index], start + first
                pieces.append(Piece(split, names[index:], *place, manifest.get("poses", True)))
        start += ends[-1]
    return pieces


def survey(
    root: Path, manifest: dict[str, Any], config: str, workers: int = 1, progress: bool = False
) -> Survey:
    """Read all rows of a config in `workers` processes; small configs in this one.

    Raises:
        RacinesError: a shard cannot be read at all, or its columns are not those of the schema.
    """
    pieces = plan_pieces(root, manifest, config)
    found = Survey(config)
    try:
        store_frames = len(FrameStore(root, config))
    except RacinesError as error:
        store_frames = None
        found.faults["store"] = [f"{error}"]
    total = sum(piece.frames for piece in pieces)
    with progress_bar(progress) as bar:
        task = bar.add_task(f"checking {config}", total=total)
        given = root, config, manifest_labels(manifest), store_frames is not None
        for piece, (sweeps, faults) in zip(pieces, _read(pieces, given, workers), strict=True):
            found.sweeps += sweeps
            if faults:
                found.faults.setdefault("rows", []).extend(faults)
            for check, reason in (fault for sweep in sweeps for fault in sweep.faults):
                found.faults.setdefault(check, []).append(reason)
            bar.advance(task, piece.frames)
    if store_frames not in (None, total):
        reason = f"the store has {store_frames} frames, the shards {total}"
        found.faults.setdefault("store", []).append(reason)
    return found


def _read(
    pieces: Sequence[Piece], given: tuple[Path, str, Sequence[str], bool], workers: int
) -> Iterator[tuple[list[CheckedSweep], list[str]]]:
    if workers == 1 or sum(piece.frames for piece in pieces) < WORTH_WORKERS:
        state = _open(*given)
        yield from (read_piece(*state, piece) for piece in pieces)
        return
    with worker_pool(workers, _start, given, "with fewer --workers") as pool:
        yield from pool.map(_work, pieces)


def _open(
    root: Path, config: str, labels: Sequence[str], stored: bool
) -> tuple[Path, Sequence[str], FrameStore | None]:
    return root, labels, FrameStore(root, config) if stored else None


def _start(*given: Any) -> None:
    global _state
    _state = _open(*given)


def _work(piece: Piece) -> tuple[list[CheckedSweep], list[str]]:
    assert _state is not None
    return read_piece(*_state, piece)
