"""Making trajectories in worker processes, each staged as one file that survives a kill.

    plan()  ──>  unit 0, 1, 2 …  ──>  workers: produce, check, PNG  ──>  units/00000.arrow …

A staged file is complete or absent (written aside, then renamed), so that a build that was killed
goes on where it stopped. What a unit's file holds does not depend on the worker that made it.
"""

import hashlib
import inspect
import multiprocessing
import multiprocessing.connection
import os
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from pathlib import Path

import pyarrow as pa
import torch

from racines_data.digest import trajectory_digest
from racines_data.errors import RacinesError
from racines_data.files import working_folder
from racines_data.progress import progress_bar
from racines_data.records import check_trajectory, pixels_array, trajectory_to_table
from racines_data.sources.base import Source, Unit, has_poses, labels_of_source

_DIGEST = b"racines.digest"
_source: Source | None = None  # a worker's own copy, set by its initialiser


def staging_folder(out: Path, source: Source, recipe_digest: str) -> AbstractContextManager[Path]:
    """Open the staging folder of a build, beside its output; removed when the build succeeds.

    Its name tells the recipe and the code apart, so that units of another are never taken up.

    Raises:
        RacinesError: another build of the same dataset is running.
    """
    key = f"{recipe_digest}/{_code_digest(source)}"
    return working_folder(out, "staging", key, "another build of it is running; wait for it")


def _code_digest(source: Source) -> str:
    files = {*Path(__file__).parent.rglob("*.py"), Path(inspect.getfile(type(source)))}
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def unit_path(folder: Path, index: int) -> Path:
    """Return the file of a staged unit."""
    return folder / "units" / f"{index:05d}.arrow"


def open_unit(path: Path) -> tuple[pa.Table, str]:
    """Return a staged unit, memory-mapped (rows of `frames` and a `pixels` column), its digest."""
    table = pa.ipc.open_file(pa.memory_map(str(path))).read_all()
    return table, (table.schema.metadata or {})[_DIGEST].decode()


def stage_units(
    source: Source,
    units: Sequence[Unit],
    folder: Path,
    workers: int,
    progress: bool,
    by_session: bool = False,
) -> None:
    """Make the units that are not staged yet, in `workers` processes.

    Args:
        source: Makes the units.
        units: All units, in order.
        folder: Folder of this source's units.
        workers: Number of processes.
        progress: Show a progress bar on stderr.
        by_session: Give a session's units to one worker, one after the other: for a source to
            which a session costs something (a heart is baked once).

    Raises:
        RacinesError: the source refuses a unit, or a worker dies.
    """
    (folder / "units").mkdir(parents=True, exist_ok=True)
    waiting = [index for index in range(len(units)) if not _is_staged(folder, index)]
    tasks: dict[str | int, list[int]] = {}
    for index in waiting:
        tasks.setdefault(units[index].session if by_session else index, []).append(index)
    with progress_bar(progress) as bar:
        task = bar.add_task(f"{folder.name} frames", total=sum(unit.frames for unit in units))
        done = set(range(len(units))) - set(waiting)
        bar.advance(task, sum(units[index].frames for index in done))
        for indices in _produce(source, units, list(tasks.values()), folder, workers):
            bar.advance(task, sum(units[index].frames for index in indices))


def _is_staged(folder: Path, index: int) -> bool:
    try:
        open_unit(unit_path(folder, index))
    except (OSError, KeyError, pa.ArrowInvalid):
        return False
    return True


def _produce(
    source: Source, units: Sequence[Unit], tasks: Sequence[list[int]], folder: Path, workers: int
) -> Iterator[list[int]]:
    if workers == 1 or len(tasks) < 2:
        threads = torch.get_num_threads()
        torch.set_num_threads(1)  # as in a worker: the number of threads may change last bits
        try:
            for indices in tasks:
                for index in indices:
                    _stage(source, units[index], folder, index)
                yield indices
        finally:
            torch.set_num_threads(threads)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, _start_worker, (source,)) as pool:
        futures = [
            pool.submit(_work, [units[index] for index in indices], folder, indices)
            for indices in tasks
        ]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BrokenProcessPool as error:
            raise RacinesError(
                "a worker process died (out of memory?): run again to go on, with fewer workers"
            ) from error
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _start_worker(source: Source) -> None:
    global _source
    _source = source
    torch.set_num_threads(1)
    threading.Thread(target=die_with_parent, daemon=True).start()


def die_with_parent() -> None:
    """Wait for the parent of a worker to end, then end the worker; run it in a thread.

    A pool's workers outlive a parent that was killed, waiting for work that never comes.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        multiprocessing.connection.wait([parent.sentinel])
        os._exit(1)


def _work(units: list[Unit], folder: Path, indices: list[int]) -> list[int]:
    assert _source is not None
    for unit, index in zip(units, indices, strict=True):
        _stage(_source, unit, folder, index)
    return indices


def _stage(source: Source, unit: Unit, folder: Path, index: int) -> None:
    trajectory = source.produce(unit)
    labels = labels_of_source(source)
    check_trajectory(trajectory, unit, labels, has_poses(source))
    table = trajectory_to_table(trajectory, source.name, labels)
    table = table.append_column("pixels", pixels_array(trajectory.images))
    metadata = {**(table.schema.metadata or {}), _DIGEST: trajectory_digest(trajectory).encode()}
    table = table.replace_schema_metadata(metadata)
    path = unit_path(folder, index)
    aside = path.with_suffix(f".{os.getpid()}")
    with pa.OSFile(str(aside), "wb") as file, pa.ipc.new_file(file, table.schema) as writer:
        writer.write_table(table)
    os.replace(aside, path)
