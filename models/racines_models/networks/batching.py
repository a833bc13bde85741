"""Rows that ignore their batch: a result depends on its own row alone, to the last bit.

Kernels are chosen by shape, so that all rows are taken in chunks of one size. Within a chunk,
oneDNN's convolutions treat every place alike; MKL's matrix products do not: the last rows, or the
columns of a narrow layer, take code that rounds otherwise (by 1e-7 of the value, on AVX-512 and on
AVX2). Dense layers therefore multiply each row on its own here.

Convolutions in bfloat16 are oneDNN's own where the processor has units for it. Elsewhere its
stand-in is ten times slower than float32, so that its sums are taken in float32 kernels here: of
numbers rounded to bfloat16, whose products are exact, and rounded once at the end, as the units do.
"""

from collections.abc import Callable
from contextlib import nullcontext
from typing import Any, TypeVar, cast

import torch
from torch import Tensor
from torch.nn.functional import conv2d, linear, pad
from torch.overrides import TorchFunctionMode

from racines_models.devices import has_bfloat16

SIZE = {"cpu": 8, "cuda": 256}
"""Rows per call by device type. Eight is also the fastest for most generators on a CPU, whose
caches it fits."""
ALIGNED = 16
"""Numbers in a cache line, which begins every row of a product: code may depend on alignment."""

Result = TypeVar("Result", bound=Tensor | tuple[Tensor, ...])


def in_fixed_batches(function: Callable[..., Result], *inputs: Tensor, size: int = 0) -> Result:
    """Apply `function` to (B, …) inputs in chunks of one size, the last one padded with ones.

    It treats rows independently, but for rounding, and returns a tensor or a tuple of tensors,
    (B, …) each; B may be 0. What is returned is for each row to the last bit the same at every
    place of every batch, on one machine with one number of threads. `size` rows make a chunk; 0:
    as many as suit the device.
    """
    count, kind = len(inputs[0]), inputs[0].device.type
    size = size or SIZE.get(kind, 256)
    short = -count % size if count else size
    # The copy is aligned as any other batch is, also where the inputs are part of a tensor.
    padded = [torch.cat([x, x.new_ones(1).expand(short, *x.shape[1:])]) for x in inputs]
    chunks = zip(*(x.split(size) for x in padded), strict=True)
    with _OnCPU() if kind == "cpu" else nullcontext():
        parts: list[Any] = [function(*chunk) for chunk in chunks]
    if isinstance(parts[0], Tensor):
        return cast(Result, torch.cat(parts)[:count])
    columns = zip(*parts, strict=True)
    return cast(Result, tuple(torch.cat(column)[:count] for column in columns))


class Lasting:
    """What a function said of a row's image lasts for as long as the image does.

    Episodes that have ended stay in their batch and are drawn no more, so that of a long batch's
    last steps few images are new. On a CPU only those are looked at, which changes no bit; a GPU
    looks at all, since to ask which are new would wait for it.
    """

    def __init__(self) -> None:
        self._images = self._said = torch.empty(0)

    def __call__(self, function: Callable[[Tensor], Tensor], images: Tensor) -> Tensor:
        """Apply a function to (B, …) images as `in_fixed_batches` does; it has to be the same."""
        if images.device.type != "cpu":
            return in_fixed_batches(function, images)
        if images.shape != self._images.shape:
            said = in_fixed_batches(function, images)
        else:
            new = (images != self._images).flatten(1).any(1).nonzero().squeeze(1)
            said = self._said
            if len(new):
                found = in_fixed_batches(function, images[new])
                said = said.index_copy(0, new.to(said.device), found)
        self._images, self._said = images.clone(), said
        return said


class _OnCPU(TorchFunctionMode):
    """While it is on, dense layers take their rows one by one, and bfloat16 is not emulated."""

    def __init__(self) -> None:
        super().__init__()
        self._own: dict[Any, Any] = {linear: _dense}
        if not has_bfloat16("cpu"):
            self._own[conv2d] = _convolve

    def __torch_function__(
        self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: Any = None
    ) -> Any:
        return self._own.get(func, func)(*args, **(kwargs or {}))


def _convolve(
    x: Tensor, weight: Tensor, bias: Tensor | None = None, *more: Any, **named: Any
) -> Tensor:
    """Return what `conv2d` returns in bfloat16, by float32 kernels; in other types itself."""
    on = torch.is_autocast_enabled("cpu")
    if (torch.get_autocast_dtype("cpu") if on else x.dtype) != torch.bfloat16:
        return conv2d(x, weight, bias, *more, **named)
    parts = [None if t is None else t.to(torch.bfloat16).float() for t in (x, weight, bias)]
    with torch.autocast("cpu", enabled=False):
        return conv2d(*cast(Any, parts), *more, **named).to(torch.bfloat16)


def _dense(x: Tensor, weight: Tensor, bias: Tensor | None = None) -> Tensor:
    """Return what `linear` returns of (B, …, inputs): products of one shape and alignment a row.

    Rounded to the type of autocast where it is on; sums are float32 or better, as in its kernels.
    """
    kind, (outputs, width) = x.device.type, weight.shape
    dtype = torch.get_autocast_dtype(kind) if torch.is_autocast_enabled(kind) else x.dtype
    exact = torch.promote_types(dtype, torch.float32)
    rows = x.to(dtype).to(exact).reshape(len(x), -1, width).contiguous()
    columns = weight.to(dtype).to(exact)
    if width % ALIGNED or outputs % ALIGNED:
        rows = pad(rows, (0, -width % ALIGNED))
        columns = pad(columns, (0, -width % ALIGNED, 0, -outputs % ALIGNED))
    with torch.autocast(kind, enabled=False):
        out = torch.bmm(rows, columns.T.expand(len(x), -1, -1))[..., :outputs]
    if bias is not None:
        out = out + bias.to(dtype)
    return out.reshape(*x.shape[:-1], outputs).to(dtype)
