"""Reading every row of a config once, in parallel, for all checks that look at rows.

    shards ──> pieces of whole trajectories ──> workers: decode, check, digest, signature ──> Survey

A trajectory may cross shards: it belongs to the shard in which it begins.
"""

import multiprocessing
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import torch

from racines_data.build.staging import die_with_parent
from racines_data.errors import RacinesError
from racines_data.manifest import manifest_labels
from racines_data.progress import progress_bar
from racines_data.records import features_of
from racines_data.store.frames import FrameStore
from racines_data.validate.rows import CheckedSweep, Piece, read_piece, run_edges

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
        """Raise what was found for a check, if anything.

        Raises:
            RacinesError: the first reason, and how many more there are.
        """
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
        runs = list(_runs(root, names))
        for _, group in groupby(runs, key=lambda run: run[0][0]):
            parts = _join([part for run in group for part in run])
            pieces.append(Piece(split, parts, start, manifest.get("poses", True)))
            start += pieces[-1].frames
    return pieces


def _runs(root: Path, names: Sequence[str]) -> Iterator[list[tuple[str, int, int]]]:
    """Yield the parts of each trajectory: file, first row, past-the-last row."""
    last, run = None, []
    for name in names:
        ids = pq.read_table(root / name, columns=["trajectory"])["trajectory"]
        words = ids.to_numpy()
        for first, stop in pairwise(run_edges(words)):
            word = words[first]
            if run and word != last:
                yield run
                run = []
            run.append((name, first, stop))
            last = word
    if run:
        yield run


def _join(parts: Sequence[tuple[str, int, int]]) -> tuple[tuple[str, int, int], ...]:
    joined = []
    for name, group in groupby(parts, key=lambda part: part[0]):
        rows = list(group)
        joined.append((name, rows[0][1], rows[-1][2]))
    return tuple(joined)


def survey(
    root: Path, manifest: dict[str, Any], config: str, workers: int = 1, progress: bool = False
) -> Survey:
    """Read all rows of a config.

    Args:
        root: Folder of the dataset.
        manifest: Its manifest.
        config: `frames` or `multi_phantom`.
        workers: Processes that decode and check; small configs are read in this one.
        progress: Show a progress bar on stderr.

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
        root, labels, store = _open(*given)
        for piece in pieces:
            yield read_piece(root, labels, store, piece)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, _start_worker, given) as pool:
        try:
            yield from pool.map(_work, pieces)
        except BrokenProcessPool as error:
            raise RacinesError(
                "a worker process died (out of memory?): run again with fewer --workers"
            ) from error
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _open(
    root: Path, config: str, labels: Sequence[str], stored: bool
) -> tuple[Path, Sequence[str], FrameStore | None]:
    return root, labels, FrameStore(root, config) if stored else None


def _start_worker(root: Path, config: str, labels: Sequence[str], stored: bool) -> None:
    global _state
    torch.set_num_threads(1)
    threading.Thread(target=die_with_parent, daemon=True).start()
    _state = _open(root, config, labels, stored)


def _work(piece: Piece) -> tuple[list[CheckedSweep], list[str]]:
    assert _state is not None
    return read_piece(*_state, piece)
