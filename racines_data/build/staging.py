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
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa
import torch

from racines_data.digest import trajectory_digest
from racines_data.errors import RacinesError
from racines_data.files import working_folder
from racines_data.progress import progress_bar
from racines_data.records import check_trajectory, pixels_array, trajectory_to_table
from racines_data.sources.base import Source, Unit, has_poses, labels_of_source

_DIGEST = b"racines.digest"
_source: Source | None = None  # a worker's own copy
Task = list[tuple[Unit, Path]]
"""Units that one worker makes one after the other, and their files."""


def staging_folder(out: Path, source: Source, recipe_digest: str) -> AbstractContextManager[Path]:
    """Open the staging folder of a build, beside its output; removed when the build succeeds.

    Its name tells the recipe and the code apart, so that units of another are never taken up.

    Raises:
        RacinesError: another build of the same dataset is running.
    """
    code = hashlib.sha256()
    for file in sorted({*Path(__file__).parent.rglob("*.py"), Path(inspect.getfile(type(source)))}):
        code.update(file.read_bytes())
    key = f"{recipe_digest}/{code.hexdigest()}"
    return working_folder(out, "staging", key, "another build of it is running; wait for it")


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
    """Make the units that are not staged yet in `folder`, in `workers` processes.

    With `by_session` one worker makes all units of a session: for a source to which a session costs
    something (a heart is baked once).

    Raises:
        RacinesError: the source refuses a unit, or a worker dies.
    """
    (folder / "units").mkdir(parents=True, exist_ok=True)
    tasks: dict[str | int, Task] = {}
    staged = 0
    for index, unit in enumerate(units):
        path = unit_path(folder, index)
        if _is_staged(path):
            staged += unit.frames
        else:
            tasks.setdefault(unit.session if by_session else index, []).append((unit, path))
    with progress_bar(progress) as bar:
        total = sum(unit.frames for unit in units)
        shown = bar.add_task(f"{folder.name} frames", total=total, completed=staged)
        for frames in _produce(source, list(tasks.values()), workers):
            bar.advance(shown, frames)


def _is_staged(path: Path) -> bool:
    try:
        open_unit(path)
    except (OSError, KeyError, pa.ArrowInvalid):
        return False
    return True


def _produce(source: Source, tasks: Sequence[Task], workers: int) -> Iterator[int]:
    """Do the tasks; yield the number of frames of each when it is done."""
    if workers == 1 or len(tasks) < 2:
        threads = torch.get_num_threads()
        torch.set_num_threads(1)  # as in a worker: the number of threads may change last bits
        try:
            for task in tasks:
                yield _stage(source, task)
        finally:
            torch.set_num_threads(threads)
        return
    with worker_pool(workers, _take, (source,), "to go on, with fewer workers") as pool:
        for future in as_completed([pool.submit(_work, task) for task in tasks]):
            yield future.result()


@contextmanager
def worker_pool(
    workers: int, start: Callable[..., None], given: tuple[Any, ...], remedy: str
) -> Iterator[ProcessPoolExecutor]:
    """Give processes of one thread each, in which `start(*given)` runs first.

    Raises:
        RacinesError: a worker died; its message tells to run again, and the remedy.
    """
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, _start_worker, (start, given)) as pool:
        try:
            yield pool
        except BrokenProcessPool as error:
            raise RacinesError(
                f"a worker process died (out of memory?): run again {remedy}"
            ) from error
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _start_worker(start: Callable[..., None], given: tuple[Any, ...]) -> None:
    torch.set_num_threads(1)
    threading.Thread(target=_die_with_parent, daemon=True).start()
    start(*given)


def _die_with_parent() -> None:
    # A pool's workers outlive a parent that was killed, waiting for work that never comes.
    parent = multiprocessing.parent_process()
    if parent is not None:
        multiprocessing.connection.wait([parent.sentinel])
        os._exit(1)


def _take(source: Source) -> None:
    global _source
    _source = source


def _work(task: Task) -> int:
    assert _source is not None
    return _stage(_source, task)


def _stage(source: Source, task: Task) -> int:
    """Make the units of a task; return the number of frames that were expected of them."""
    labels = labels_of_source(source)
    for unit, path in task:
        trajectory = source.produce(unit)
        check_trajectory(trajectory, unit, labels, has_poses(source))
        table = trajectory_to_table(trajectory, source.name, labels)
        table = table.append_column("pixels", pixels_array(trajectory.images))
        digest = {_DIGEST: trajectory_digest(trajectory).encode()}
        table = table.replace_schema_metadata((table.schema.metadata or {}) | digest)
        aside = path.with_suffix(f".{os.getpid()}")
        with pa.OSFile(str(aside), "wb") as file, pa.ipc.new_file(file, table.schema) as writer:
            writer.write_table(table)
        os.replace(aside, path)
    return sum(unit.frames for unit, _ in task)
