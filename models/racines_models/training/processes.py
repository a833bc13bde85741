"""Several processes that train as one: equal shares of each batch, averaged gradients.

Gradients are averaged here after each backward pass, not by DistributedDataParallel: that wrapper
expects one forward and one backward pass of every weight a step, while an adversarial generator
calls a network several times, freezes another for one loss, and steps two optimizers in turn.
"""

import multiprocessing
import os
import pickle
import socket
import sys
import threading
import traceback
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, TypeVar

import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.multiprocessing.spawn import ProcessExitedException, start_processes

from racines_data.errors import RacinesError

if TYPE_CHECKING:
    from accelerate import Accelerator

T = TypeVar("T")


def is_main_process() -> bool:
    """Return whether this process writes files: the only one, or the first of several."""
    return (dist.get_rank() if _joined() else int(os.environ.get("RANK", "0"))) == 0


def leave() -> None:
    """Take leave of the other processes, if there are any."""
    if _joined():
        dist.destroy_process_group()


def _joined() -> bool:
    return dist.is_available() and dist.is_initialized()


class Processes:
    """This process among those of a run; with one process nothing here does anything."""

    def __init__(self, accelerator: "Accelerator", batch_size: int):
        self.rank, self.count = accelerator.process_index, accelerator.num_processes
        self.main = accelerator.is_main_process
        self._device = accelerator.device
        asked = {"MASTER_ADDR", "ACCELERATE_USE_CPU"} <= os.environ.keys()
        if self.count == 1 and asked and "WORLD_SIZE" not in os.environ:
            raise RacinesError(
                "accelerate launch starts several CPU processes through MPI only, and started one: "
                "use racines train generator NAME --processes N, or torchrun"
            )
        if batch_size % self.count or batch_size // self.count < 2:
            raise RacinesError(
                f"training.batch_size: {batch_size} images cannot be shared by {self.count} "
                "processes: it must be a multiple of their number, with two or more images each"
            )
        size = batch_size // self.count
        self.share = slice(self.rank * size, (self.rank + 1) * size)
        """The part of each batch that this process works on."""

    def average(self, tensors: Iterable[Tensor | None]) -> None:
        """Put the mean over processes into floating-point tensors; None is passed over."""
        if self.count == 1:
            return
        by_type: dict[torch.dtype, list[Tensor]] = {}
        for tensor in tensors:
            if tensor is not None and tensor.is_floating_point():
                by_type.setdefault(tensor.dtype, []).append(tensor)
        for group in by_type.values():
            # One message for all: many small ones would each wait for the slowest process.
            flat = torch.cat([tensor.detach().flatten() for tensor in group])
            dist.all_reduce(flat)
            flat /= self.count
            parts = flat.split([tensor.numel() for tensor in group])
            for tensor, part in zip(group, parts, strict=True):
                tensor.detach().copy_(part.view(tensor.shape))

    def average_scalars(self, scalars: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the mean over processes of named scalars."""
        if self.count == 1 or not scalars:
            return dict(scalars)
        values = torch.stack([value.detach().float() for value in scalars.values()])
        self.average([values])
        return dict(zip(scalars, values.unbind(), strict=True))

    def start_alike(self, nets: Iterable[nn.Module], seen: int) -> None:
        """Give all processes the first one's weights; refuse to go on from different counts."""
        if self.count == 1:
            return
        counts = torch.tensor([seen, -seen], device=self._device)
        dist.all_reduce(counts, dist.ReduceOp.MAX)
        if int(counts.sum()):
            remedy = "the folder of a run must be one that all of them see"
            raise RacinesError(f"the processes found different checkpoints: {remedy}")
        for net in nets:
            for tensor in net.state_dict().values():
                dist.broadcast(tensor, 0)


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
            refusal = told.read_text(encoding="utf-8") if told.is_file() else fate
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
    die_with_parent()
    try:
        Path(folder, f"{rank}.result").write_bytes(pickle.dumps(work(*arguments)))
    except RacinesError as error:
        Path(folder, f"{rank}.refusal").write_text(str(error), encoding="utf-8")
        sys.exit(1)
    except BaseException:
        traceback.print_exc()
        sys.exit(1)
    finally:
        leave()


def die_with_parent() -> None:
    """Do not go on when the command was killed: it may be started again on the same folder."""
    threading.Thread(target=_wait_for_parent, daemon=True).start()


def _wait_for_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
