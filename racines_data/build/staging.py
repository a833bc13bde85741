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
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import pyarrow as pa
import torch

from racines_data.digest import trajectory_digest
from racines_data.errors import RacinesError
from racines_data.files import naming, working_folder
from racines_data.progress import progress_bar
from racines_data.records import MASK_PIXELS, RAW_PIXELS, pixels_array, trajectory_to_table
from racines_data.sources.base import Source, Unit, has_poses, labels_of_source
from racines_data.sources.gate.bounds import Bounds, bounds_of
from racines_data.sources.gate.check import check_trajectory

_DIGEST = b"racines.digest"
_state: Any = None  # a worker's own copy
State = TypeVar("State")
Task = TypeVar("Task")
Result = TypeVar("Result")


def staging_folder(
    out: Path, source: Source, recipe_digest: str, allow: Sequence[str] = ()
) -> AbstractContextManager[Path]:
    """Open the staging folder of a build, beside its output; removed when the build succeeds.

    Its name tells the recipe, the code and what the gate allows apart, so that units of another are
    never taken up; if another build of the same dataset is running, that is a `RacinesError`.
    """
    code = hashlib.sha256()
    rooms = (Path(__file__).parent, Path(inspect.getfile(Bounds)).parent)
    own = {path for room in rooms for path in room.rglob("*.py")}
    for file in sorted({*own, Path(inspect.getfile(type(source)))}):
        code.update(file.read_bytes())
    key = "/".join([recipe_digest, code.hexdigest(), *sorted(allow)])
    return working_folder(out, "staging", key, "another build of it is running; wait for it")


def unit_path(folder: Path, index: int) -> Path:
    """Return the file of a staged unit."""
    return folder / "units" / f"{index:05d}.arrow"


def open_unit(path: Path) -> tuple[pa.Table, str]:
    """Return a staged unit, memory-mapped (rows of `frames` and a `pixels` column), its digest."""
    table = pa.ipc.open_file(pa.memory_map(str(path))).read_all()
    return table, (table.schema.metadata or {})[_DIGEST].decode()


def stage_units(
    parts: Sequence[tuple[Source, Sequence[Unit], Path, bool]],
    workers: int,
    progress: bool,
    allow: Sequence[str] = (),
) -> None:
    """Make the units of all parts that are not staged yet, in the same `workers` processes.

    A part is a source, its units, their folder, and whether one worker makes all units of a
    session: for a source to which a session costs something (a heart is baked once). What the gate
    infers is not held against them where `allow` names it.
    """
    tasks: list[tuple[int, list[tuple[Unit, Path]]]] = []
    with progress_bar(progress) as bar:
        shown = []
        for number, (_, units, folder, by_session) in enumerate(parts):
            (folder / "units").mkdir(parents=True, exist_ok=True)
            missing: dict[str | int, list[tuple[Unit, Path]]] = {}
            staged = 0
            for index, unit in enumerate(units):
                path = unit_path(folder, index)
                try:
                    open_unit(path)
                    staged += unit.frames
                except (OSError, KeyError, pa.ArrowInvalid):
                    group = unit.session if by_session else index
                    missing.setdefault(group, []).append((unit, path))
            tasks += [(number, members) for members in missing.values()]
            total = sum(unit.frames for unit in units)
            shown.append(bar.add_task(f"{folder.name} frames", total=total, completed=staged))
        sources = [(source, bounds_of(source, allow)) for source, *_ in parts]
        made = in_workers(_stage, sources, tasks, workers, "to go on, with fewer workers")
        for (number, _), frames in zip(tasks, made, strict=True):
            bar.advance(shown[number], frames)


def in_workers(
    work: Callable[[State, Task], Result],
    state: State,
    tasks: Sequence[Task],
    workers: int,
    remedy: str,
) -> Iterator[Result]:
    """Yield `work(state, task)` of each task, in order, from processes of one thread each.

    The state is pickled to each process once. One worker, or one task, is this process. If a worker
    dies, the `RacinesError` tells to run again, and the remedy.
    """
    if workers == 1 or len(tasks) < 2:
        threads = torch.get_num_threads()
        torch.set_num_threads(1)  # as in a worker: the number of threads may change last bits
        try:
            yield from (work(state, task) for task in tasks)
        finally:
            torch.set_num_threads(threads)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, _start_worker, (state,)) as pool:
        try:
            yield from pool.map(partial(_in_worker, work), tasks)
        except BrokenProcessPool as error:
            raise RacinesError(
                f"a worker process died (out of memory?): run again {remedy}"
            ) from error
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _start_worker(state: Any) -> None:
    global _state
    _state = state
    torch.set_num_threads(1)
    threading.Thread(target=_die_with_parent, daemon=True).start()


def _die_with_parent() -> None:
    # A pool's workers outlive a parent that was killed, waiting for work that never comes.
    parent = multiprocessing.parent_process()
    if parent is not None:
        multiprocessing.connection.wait([parent.sentinel])
        os._exit(1)


def _in_worker(work: Callable[[Any, Task], Result], task: Task) -> Result:
    return work(_state, task)


def _stage(
    sources: Sequence[tuple[Source, Bounds]], task: tuple[int, Sequence[tuple[Unit, Path]]]
) -> int:
    """Make some units of a source, each into its file; return the frames expected of them."""
    number, members = task
    source, bounds = sources[number]
    labels = labels_of_source(source)
    for unit, path in members:
        trajectory = source.produce(unit)
        check_trajectory(trajectory, unit, labels, has_poses(source), bounds, source.name)
        table = trajectory_to_table(trajectory, source.name, labels)
        table = table.append_column(RAW_PIXELS, pixels_array(trajectory.images))
        if trajectory.masks is not None:
            table = table.append_column(MASK_PIXELS, pixels_array(trajectory.masks))
        digest = {_DIGEST: trajectory_digest(trajectory).encode()}
        table = table.replace_schema_metadata((table.schema.metadata or {}) | digest)
        aside = path.with_suffix(f".{os.getpid()}")
        with naming(path):
            with pa.OSFile(str(aside), "wb") as file, pa.ipc.new_file(file, table.schema) as writer:
                writer.write_table(table)
            os.replace(aside, path)
    return sum(unit.frames for unit, _ in members)
