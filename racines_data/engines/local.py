"""Tasks on this machine: in this process, or in a pool of processes of their own."""

import multiprocessing
import multiprocessing.connection
import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from typing import Any, Self

import torch

from racines_data.engines import Result, State, Task
from racines_data.engines.threads import torch_threads
from racines_data.errors import RacinesError

_state: Any = None  # a worker's own copy


class LocalEngine:
    """Runs tasks in so many processes; one worker, or one task, is this process.

    Nothing outlives this process. A worker that dies ends the work.
    """

    own_files = True

    def __init__(self, workers: int | None = None, address: str | None = None) -> None:
        """Take the number of processes; there is no address."""
        self.size = workers or 1

    def __enter__(self) -> Self:
        """Start nothing: a pool lives as long as the tasks of one `map`."""
        return self

    def __exit__(self, *error: object) -> None:
        """Nothing is left to end."""

    def map(
        self,
        work: Callable[[State, Task], Result],
        state: State,
        tasks: Iterable[Task],
        threads: int | None = 1,
        remedy: str = "",
    ) -> Iterator[Result]:
        """Yield results in order, as `Engine.map`; the state is pickled to each process once."""
        if self.size > 1:
            tasks = list(tasks)
        if self.size == 1 or (isinstance(tasks, list) and len(tasks) < 2):
            with torch_threads(threads):
                yield from (work(state, task) for task in tasks)
            return
        start = state, threads or torch.get_num_threads()
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(self.size, context, _start_worker, start) as pool:
            try:
                yield from pool.map(partial(_in_worker, work), tasks)
            except BrokenProcessPool as error:
                raise RacinesError(
                    f"a worker process died (out of memory?): run again {remedy}".rstrip()
                ) from error
            finally:
                pool.shutdown(wait=True, cancel_futures=True)


def _start_worker(state: Any, threads: int) -> None:
    global _state
    _state = state
    torch.set_num_threads(threads)
    threading.Thread(target=_die_with_parent, daemon=True).start()


def _die_with_parent() -> None:
    # A pool's workers outlive a parent that was killed, waiting for work that never comes.
    parent = multiprocessing.parent_process()
    if parent is not None:
        multiprocessing.connection.wait([parent.sentinel])
        os._exit(1)


def _in_worker(work: Callable[[Any, Task], Result], task: Task) -> Result:
    return work(_state, task)
