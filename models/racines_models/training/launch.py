"""Starts several processes of one training on this machine."""

import multiprocessing
import os
import pickle
import socket
import sys
import threading
import traceback
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import torch
from torch.multiprocessing.spawn import ProcessExitedException, start_processes

from racines_data.errors import RacinesError
from racines_models.training.processes import leave

T = TypeVar("T")


def in_processes(count: int, work: Callable[..., T], *arguments: Any) -> T:
    """Call `work` in `count` processes that know of each other, as torchrun would.

    On CUDA each takes the device of its number. `work` is a function of a module, so that other
    processes can import it; what it takes and returns must be picklable.

    Returns:
        What the first process returned.

    Raises:
        RacinesError: a process refused its input, or died; the others are ended.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with TemporaryDirectory() as folder:
        try:
            given = (count, port, Path(folder), work, arguments)
            start_processes(_worker, given, count, daemon=True)
        except ProcessExitedException as error:
            told = Path(folder, f"{error.error_index}.refusal")
            fate = f"it ended with exit code {error.exit_code}"
            refusal = told.read_text() if told.is_file() else fate
            raise RacinesError(f"process {error.error_index} of {count}: {refusal}") from error
        return pickle.loads(Path(folder, "0.result").read_bytes())


def _worker(
    rank: int, count: int, port: int, folder: Path, work: Callable[..., Any], arguments: Any
) -> None:
    """Leave what `work` returns, or why it refused, as a file in the folder."""
    os.environ |= {"RANK": str(rank), "LOCAL_RANK": str(rank)}
    os.environ |= {"WORLD_SIZE": str(count), "LOCAL_WORLD_SIZE": str(count)}
    os.environ |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port)}
    if "OMP_NUM_THREADS" not in os.environ:
        torch.set_num_threads(max(1, (os.cpu_count() or 1) // count))
    threading.Thread(target=_die_with_parent, daemon=True).start()
    try:
        Path(folder, f"{rank}.result").write_bytes(pickle.dumps(work(*arguments)))
    except RacinesError as error:
        Path(folder, f"{rank}.refusal").write_text(str(error))
        sys.exit(1)
    except BaseException:
        traceback.print_exc()
        sys.exit(1)
    finally:
        leave()


def _die_with_parent() -> None:
    """Do not go on when the command was killed: it may be started again on the same folder."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
