"""Gradient steps replayed as one CUDA graph: a small network's step is bound by its launches."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import torch

if TYPE_CHECKING:
    from tensordict import TensorDictBase

WARM_UP = 5
"""Steps taken one kernel at a time before the graph is captured, as PyTorch's notes ask for."""
Step = Callable[["TensorDictBase"], "TensorDictBase"]


def replayed(step: Step, rows: int, device: str) -> Step:
    """Return a step that on CUDA replays a graph of itself where it gets `rows` rows.

    Elsewhere, and on batches of another size, it is the step itself. Networks and optimiser have to
    stay the same objects from then on, learning rates to be tensors (`set_rate`), and the step must
    not wait for the device; tensordict does so once before each replay.
    """
    if not device.startswith("cuda"):
        return step
    from tensordict.nn import CudaGraphModule

    taken: Any = step  # its type there knows of nothing that is returned
    graph = CudaGraphModule(
        taken, warmup=WARM_UP, in_keys=[], out_keys=[], device=torch.device(device)
    )
    return lambda batch: graph(batch) if len(batch) == rows else step(batch)


def set_rate(group: dict[str, Any], rate: float, device: str) -> None:
    """Set a parameter group's learning rate: on CUDA the tensor that a captured step reads."""
    if not device.startswith("cuda"):
        group["lr"] = rate
    elif isinstance(group["lr"], torch.Tensor) and group["lr"].is_cuda:
        group["lr"].fill_(rate)
    else:
        group["lr"] = torch.tensor(rate, device=device)
