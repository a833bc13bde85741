"""Several processes that train as one: equal shares of each batch, averaged gradients.

Gradients are averaged here after each backward pass, not by DistributedDataParallel: that wrapper
expects one forward and one backward pass of every weight a step, while an adversarial generator
calls a network several times, freezes another for one loss, and steps two optimizers in turn.
"""

import os
from collections.abc import Iterable, Mapping

import torch
import torch.distributed as dist
from accelerate import Accelerator
from torch import Tensor, nn

from racines_data.errors import RacinesError


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

    def __init__(self, accelerator: Accelerator, batch_size: int):
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

    def average_buffers(self, nets: Iterable[nn.Module]) -> None:
        """Average running statistics, each of which saw its own share of the batch."""
        if self.count > 1:
            self.average(buffer for net in nets for buffer in net.buffers())

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
