"""Starts several processes of one training on this machine. Imports no torch: see `_worker`."""

import multiprocessing
import os
import socket
import threading
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from racines_data.errors import RacinesError

T = TypeVar("T")


def in_processes(count: int, work: Callable[..., T], *arguments: Any) -> T:
    """Call `work` in `count` processes that know of each other, as torchrun would.

    Args:
        count: processes; each takes the CUDA device of its number, if training is on CUDA.
        work: a function of a module, so that other processes can import it.
        arguments: what it is called with; must be picklable.

    Returns:
        What the first process returned.

    Raises:
        RacinesError: a process refused its input, or died; the others are ended.
    """
    context = multiprocessing.get_context("spawn")
    port = _free_port()
    pipes = [context.Pipe(duplex=False) for _ in range(count)]
    workers = [
        context.Process(target=_worker, args=(rank, count, port, pipes[rank][1], work, arguments))
        for rank in range(count)
    ]
    try:
        for worker in workers:
            worker.start()
        for _, theirs in pipes:
            theirs.close()
        return _results([ours for ours, _ in pipes], workers)[0]
    finally:
        for worker in workers:
            if worker.is_alive():
                worker.terminate()
            worker.join()


def _results(pipes: list[Connection], workers: Sequence[BaseProcess]) -> list[Any]:
    results: dict[int, Any] = {}
    while len(results) < len(pipes):
        waiting = [pipe for rank, pipe in enumerate(pipes) if rank not in results]
        for pipe in wait(waiting):
            assert isinstance(pipe, Connection)
            rank = pipes.index(pipe)
            try:
                results[rank], refusal = pipe.recv()
            except EOFError:
                workers[rank].join()
                refusal = f"it ended with exit code {workers[rank].exitcode}"
            if refusal:
                raise RacinesError(f"process {rank} of {len(pipes)}: {refusal}")
    return [results[rank] for rank in range(len(pipes))]


def _worker(
    rank: int,
    count: int,
    port: int,
    pipe: Connection,
    work: Callable[..., Any],
    arguments: tuple[Any, ...],
) -> None:
    os.environ |= {"RANK": str(rank), "LOCAL_RANK": str(rank)}
    os.environ |= {"WORLD_SIZE": str(count), "LOCAL_WORLD_SIZE": str(count)}
    os.environ |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port)}
    # Read when torch is first imported, which is inside `work`.
    os.environ.setdefault("OMP_NUM_THREADS", str(max(1, (os.cpu_count() or 1) // count)))
    threading.Thread(target=_die_with_parent, daemon=True).start()
    from racines_models.training.processes import leave

    try:
        pipe.send((work(*arguments), ""))
    except RacinesError as error:
        pipe.send((None, str(error)))
    finally:
        leave()


def _die_with_parent() -> None:
    """Do not go on when the command was killed: it may be started again on the same folder."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]
