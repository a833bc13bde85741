"""How far rendering, grading and steps are from what the machine can do.

OMP_NUM_THREADS=1 python -m tests.benchmarks.limits docs/results/limits.json

Four limits are measured: copies and random reads of memory far beyond the caches, products of
matrices, and calls of the tensor library that have next to nothing to do. Beside them stands what
each piece of work takes, by two counts of bytes. The least is what any program has to move: voxels
under samples, each read once, or weights, and what goes in and comes out. The other is what the
tensor operations read and write as they are written; most of it never leaves the caches, which are
quicker than memory, so its share may be above one. Floating-point operations are those of products,
convolutions and shifted sums, the filters; all other arithmetic is left out.

One or two minutes; times are of the median round.
"""

import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from torch import Tensor
from torch.profiler import ProfilerActivity, profile
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils.flop_counter import FlopCounterMode

from racines_data.files import write_json
from racines_data.geometry import Pose
from racines_data.imaging import IMAGE_SIZE
from racines_data.patients import Pool
from racines_data.patients.settings import PROBE
from racines_data.phantom import shared_phantom
from racines_data.randomness import sample_seeds
from racines_envs.task.actions import ACTIONS
from racines_models.devices import has_bfloat16
from racines_models.judges.grader.model import Grader
from racines_models.provenance import environment
from tests.benchmarks.test_render import poses
from tests.benchmarks.turns import in_turns, rate
from tests.conftest import ROOT

FIRST, LONGEST = 10_000, 5
"""Seed of the first heart, and operations that are told."""
STEPS = 10
PIXELS = IMAGE_SIZE**2
STEP_BYTES = 2 * 12 * 4 + 9 * 4 + 8 + 8 + 2
"""Of a row: pose before and after, what is observed, action, reward, flags."""


@dataclass(frozen=True)
class Size:
    """How much is measured."""

    copied: int = 256 << 20
    """Bytes of an array that is copied, or read from."""
    read: int = 4 << 20
    """Numbers of eight bytes that are read at random places."""
    product: int = 1024
    """Rows and columns of matrices."""
    rows: int = 64
    hearts: int = 8
    rounds: int = 15


@dataclass(frozen=True)
class Work:
    """A piece of work, and what any program would have to move for it."""

    run: Callable[[], object]
    least: int
    """Bytes."""
    voxels: int = 0
    """Of them, eight bytes each, at places that differ from pose to pose."""
    product: torch.dtype = torch.float32
    """Type of what is multiplied."""


class Traffic(TorchDispatchMode):
    """Counts operations, and the bytes that each reads and writes; views move nothing."""

    GATHERS = ("index_select", "index", "gather", "take")
    WRITES = ("copy_", "fill_", "zero_")  # what is overwritten is not read
    FREE = ("_unsafe_view", "empty", "empty_like", "new_empty", "empty_strided", "lift_fresh")

    def __init__(self) -> None:
        super().__init__()
        self.operations = self.bytes = self.sums = 0

    def __torch_dispatch__(
        self, func: Any, types: Any, args: Any = (), kwargs: Any = None
    ) -> object:
        kwargs = kwargs or {}
        made = func(*args, **kwargs)
        name = func._schema.name.split("::")[1]
        aliases = [each.alias_info for each in func._schema.returns]
        if name in self.FREE or any(alias and not alias.is_write for alias in aliases):
            return made
        written = sum(bytes_of(each) for each in tensors(made))
        given = args[1:] if name in (*self.GATHERS, *self.WRITES) else args
        named = {key: value for key, value in kwargs.items() if key != "out"}
        read = sum(bytes_of(each) for each in tensors((given, named)))
        self.operations += 1
        self.bytes += read + written * (2 if name in self.GATHERS else 1)
        if name in ("add", "add_", "sub", "sub_") and kwargs.get("alpha", 1) != 1:
            self.sums += 2 * sum(each.numel() for each in tensors(made))
        return made


def tensors(found: Any) -> Iterator[Tensor]:
    """Yield the tensors among arguments or results."""
    if isinstance(found, Tensor):
        yield found
    elif isinstance(found, (list, tuple)):
        for each in found:
            yield from tensors(each)
    elif isinstance(found, dict):
        yield from tensors([*found.values()])


def bytes_of(tensor: Tensor) -> int:
    """Return the bytes of a tensor; what is repeated by a view counts once."""
    counts = (n for n, step in zip(tensor.shape, tensor.stride(), strict=True) if step or n == 0)
    return int(np.prod([*counts], dtype=np.int64)) * tensor.element_size()


def works(size: Size) -> dict[str, Work]:
    """Return the pieces of work."""
    rows, each = size.rows, torch.arange(size.rows)
    phantom, seeds, pose = shared_phantom(), sample_seeds(0, size.rows), poses(size.rows)
    pool, whose = Pool(range(FIRST, FIRST + size.hearts), beating=True), each % size.hearts
    nominal = pool.targets(whose)
    beating = Pose(nominal.position[each, each % 5], nominal.rotation[each, each % 5])
    phase = torch.rand((rows, 2), generator=torch.Generator().manual_seed(0)).double()
    grader = Grader.load(ROOT / "models/weights/grader")
    weights = sum(each.nbytes for each in grader.network.parameters())
    images = phantom.render(pose, seeds)
    half = grader.config.bf16 and has_bfloat16("cpu")
    voxels = rows * PROBE.beams * PROBE.samples
    drawn = voxels * 8 + rows * PIXELS
    return {
        f"{rows} frames of the one heart": Work(lambda: phantom.render(pose, seeds), drawn, voxels),
        f"{rows} frames of beating patients": Work(
            lambda: pool.render(beating, whose, phase, seeds), drawn, voxels
        ),
        f"{rows} images through the ResNet-18 grader": Work(
            lambda: grader.judge(images), weights + rows * PIXELS,
            product=torch.bfloat16 if half else torch.float32,
        ),
        f"{STEPS} steps of {rows} environments, params": Work(
            stepping(rows), STEPS * rows * STEP_BYTES
        ),
    }  # fmt: skip


def stepping(rows: int) -> Callable[[], None]:
    """Return what takes some random steps of environments that see the pose."""
    env = gymnasium.make_vec(
        "racines_envs:racines/SC-v0", num_envs=rows, observation="params", reward="oracle"
    )
    actions = np.random.default_rng(0).integers(len(ACTIONS), size=(STEPS, rows))
    env.reset(seed=0)

    def run() -> None:
        for action in actions:
            env.step(action)

    return run


def limits(size: Size) -> dict[str, float]:
    """Return bytes, random reads, operations of products by type, and calls, all a second."""
    table = torch.arange(size.copied // 8)
    other, g = torch.empty_like(table), torch.Generator().manual_seed(0)
    places = torch.randint(len(table), (size.read,), generator=g)
    read, n, few = torch.empty_like(places), size.product, torch.ones(8)
    square = torch.rand((n, n), generator=g)
    sides: dict[str, tuple[float, Callable[[], object]]] = {
        "copy": (2 * table.nbytes, lambda: other.copy_(table)),
        "gather": (size.read, lambda: torch.index_select(table, 0, places, out=read)),
        "call": (1_000, lambda: [few.add_(0.0) for _ in range(1_000)]),
    }
    for kind in (torch.float32, *([torch.bfloat16] if has_bfloat16("cpu") else [])):
        both = square.to(kind)
        sides[str(kind)] = 2 * n**3, lambda both=both: torch.mm(both, both)
    times = in_turns({name: work for name, (_, work) in sides.items()}, size.rounds)
    return {name: rate(count, times[name]) for name, (count, _) in sides.items()}


def counted(run: Callable[[], object]) -> dict[str, int]:
    """Return what the tensor operations of some work move and compute."""
    with FlopCounterMode(display=False) as flops, Traffic() as traffic:
        run()
    return {
        "operations": traffic.operations,
        "bytes": traffic.bytes,
        "flops": flops.get_total_flops() + traffic.sums,
    }


def longest(run: Callable[[], object]) -> dict[str, float]:
    """Return the operations that take longest by themselves, with their shares of all."""
    times: dict[str, float] = {}
    for _ in range(2):  # the profiler's own start falls into the first
        with profile(activities=[ProfilerActivity.CPU]) as told:
            for _ in range(3):
                run()
        times = {event.key: event.self_cpu_time_total for event in told.key_averages()}
    names = sorted(times, key=lambda name: -times[name])[:LONGEST]
    return {name: times[name] / sum(times.values()) for name in names}


def measure(size: Size) -> dict[str, Any]:
    """Return the limits, and of each piece of work its time, counts and shares of the limits."""
    rates, pieces = limits(size), works(size)
    times = in_turns({name: work.run for name, work in pieces.items()}, size.rounds)
    told = {}
    for name, work in pieces.items():
        counts = counted(work.run)
        a_second = rate(1, times[name])
        shares = {
            "gather": work.voxels * a_second / rates["gather"],
            "least": work.least * a_second / rates["copy"],
            "bytes": counts["bytes"] * a_second / rates["copy"],
            "flops": counts["flops"] * a_second / rates[str(work.product)],
            "operations": counts["operations"] * a_second / rates["call"],
        }
        told[name] = counts | {
            "seconds": 1 / a_second, "voxels": work.voxels, "least": work.least,
            "product": str(work.product), "shares": shares, "longest": longest(work.run),
        }  # fmt: skip
    return {"limits": rates, "works": told}


def tables(measured: Mapping[str, Any]) -> dict[str, Any]:
    """Return what was measured as the documentation shows it."""
    rates, works = measured["limits"], measured["works"]
    columns = ["work", "time", "voxels read", "bytes, at least", "bytes of its operations",
               "products and filters", "operations"]  # fmt: skip

    def cell(count: str, share: float) -> str:
        return f"{count} ({percent(share)})"

    rows = [
        [
            name, f"{each['seconds'] * 1e3:.2f} ms",
            cell(f"{each['voxels'] / 1e6:.2f} M", each["shares"]["gather"])
            if each["voxels"] else "–",
            cell(f"{each['least'] / 1e6:.2f} MB", each["shares"]["least"]),
            cell(f"{each['bytes'] / 1e6:,.1f} MB", each["shares"]["bytes"]),
            cell(f"{each['flops'] / 1e9:.2f} GFLOP", each["shares"]["flops"])
            if each["flops"] else "–",
            cell(f"{each['operations']:,}", each["shares"]["operations"]),
        ]
        for name, each in works.items()
    ]  # fmt: skip
    own = [
        [name, *(f"`{key}` {percent(share)}" for key, share in each["longest"].items())]
        for name, each in works.items()
    ]
    machine = [
        ["copies of memory, read and written", f"{rates['copy'] / 1e9:.1f} GB/s"],
        ["random reads of eight bytes", f"{rates['gather'] / 1e6:,.0f} M/s"],
        ["products in float32", f"{rates['torch.float32'] / 1e9:,.0f} GFLOP/s"],
        ["products in bfloat16", f"{rates['torch.bfloat16'] / 1e9:,.0f} GFLOP/s"]
        if "torch.bfloat16" in rates else ["products in bfloat16", "no units for them"],
        ["calls of the tensor library", f"{rates['call'] / 1e3:,.0f} k/s"],
    ]  # fmt: skip
    heads = ["work", *(f"{place}." for place in range(1, LONGEST + 1))]
    return {
        "ceilings": {"columns": ["limit", "measured"], "right": 1, "rows": machine},
        "limits": {"columns": columns, "right": 1, "rows": rows},
        "longest": {"columns": heads, "rows": own},
    }


def percent(share: float) -> str:
    """Return a share to two digits or so."""
    return f"{share * 100:.{0 if share >= 0.1 else 1}f} %"


def document(size: Size, out: Path | str) -> dict[str, Any]:
    """Return the file of what is measured."""
    measured, where = measure(size), environment("cpu")
    threads = where["threads"]
    told = f"{where['cpu']}, {threads} thread{'s' if threads > 1 else ''}, torch {where['torch']}"
    return {
        "schema": "racines.figures/1",
        "what": "rendering, grading and steps beside what memory, products and calls allow",
        "command": f"OMP_NUM_THREADS={threads} python -m tests.benchmarks.limits {out}",
        "machine": told,
        "source": "measured once",
        "measured": measured,
        "tables": tables(measured),
    }


if __name__ == "__main__":
    place = Path(sys.argv[1])
    write_json(place, content := document(Size(), place))
    for table in content["tables"].values():
        for row in [table["columns"], *table["rows"]]:
            print(" | ".join(row))
