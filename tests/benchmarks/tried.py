"""What was tried on the renderer, and whether it pays.

OMP_NUM_THREADS=2 python -m tests.benchmarks.tried docs/results/tried.json

Every way draws the same poses as today's, in turns in one process, and its pictures are compared.
Nothing of the product is changed for it: constants, functions and voxels are replaced while a way
draws, and a function that is to read other voxels is today's with those lines rewritten. Two or
three minutes.
"""

import copy
import inspect
import signal
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any
from unittest.mock import patch

import torch
from torch import Tensor
from torch._inductor import config

from racines_data.files import write_json
from racines_data.geometry import Pose
from racines_data.patients import Pool
from racines_data.patients import pool as pools
from racines_data.patients import render as patients
from racines_data.phantom import acoustics, model, shared_phantom
from racines_data.randomness import sample_seeds
from racines_leaderboard.determinism.stages import threads
from racines_models.provenance import environment
from tests.benchmarks.test_render import poses
from tests.benchmarks.turns import in_turns, ratios

HEART, PATIENTS = "the one heart", "beating patients"
ALLOWED = {HEART: 0, PATIENTS: 1}
"""Gray levels by which a way that is taken may differ."""
TODAY = "as it is"
HALVES = {"float16": torch.float16, "bfloat16": torch.bfloat16}
FIRST = 10_000
GAIN = 1.03
"""Times as quick that a way has to be in the median round, and no slower in any: rounds scatter."""


@dataclass(frozen=True)
class Size:
    """How much is tried."""

    rows: int = 64
    hearts: int = 8
    rounds: int = 15
    chunks: tuple[int, ...] = (8, 16, 32)
    patience: float = 60.0
    """Seconds within which a function has to be compiled; 0: none is."""


@dataclass
class World:
    """What is drawn, and how by each way."""

    today: Callable[[], Tensor]
    ways: dict[str, Callable[[], Tensor]]
    failed: dict[str, str]
    """Ways that do not draw, and why."""
    prepared: dict[str, float]
    """Seconds that a way takes once."""


def while_set(
    draw: Callable[[], Tensor], *changes: Callable[[], AbstractContextManager[Any]]
) -> Callable[[], Tensor]:
    """Return what draws while something is changed."""

    def run() -> Tensor:
        with ExitStack() as stack:
            for change in changes:
                stack.enter_context(change())
            return draw()

    return run


def replaced(owner: Any, name: str, value: Any) -> Callable[[], AbstractContextManager[Any]]:
    """Return a change of an attribute."""
    return lambda: patch.object(owner, name, value)


def rewritten(function: Callable[..., Any], **lines: tuple[str, str]) -> Callable[..., Any]:
    """Return a function with pieces of its code replaced, each of which has to be there."""
    source = textwrap.dedent(inspect.getsource(function))
    for old, new in lines.values():
        if old not in source:
            raise ValueError(f"{function.__name__} has no {old!r}: write this way anew")
        source = source.replace(old, new)
    space = dict(vars(sys.modules[function.__module__]))
    exec(source, space)
    return space[function.__name__]


def of_heart(size: Size) -> World:
    """Return the ways of drawing the one heart."""
    phantom, seeds, pose = shared_phantom(), sample_seeds(0, size.rows), poses(size.rows)

    def draw(phantom: model.Phantom = phantom) -> Tensor:
        return phantom.render(pose, seeds)

    ways = {
        f"{n} at a time": while_set(draw, replaced(model, "CHUNK", {"cpu": n})) for n in size.chunks
    }
    ways |= of_threads(draw)
    for name, kind in HALVES.items():
        other, sample = copy.copy(phantom), packed_as(acoustics.sample_echoes, name)
        other._volume = phantom._volume._replace(packed=halved(phantom._volume.packed, kind))
        change = replaced(acoustics, "sample_echoes", sample)
        ways[f"scatterers in {name}"] = while_set(lambda other=other: draw(other), change)
        wide, sample = copy.copy(phantom), unpacked(acoustics.sample_echoes)
        wide._volume = phantom._volume._replace(packed=columns(phantom._volume.packed, kind))
        change = replaced(acoustics, "sample_echoes", sample)
        ways[f"voxels as six numbers in {name}"] = while_set(lambda wide=wide: draw(wide), change)
    world = World(draw, ways, {}, {})
    compiled(world, acoustics, "sample_echoes", size)
    return world


def of_patients(size: Size) -> World:
    """Return the ways of drawing hearts that beat, of as many patients as there are."""
    pool, each = Pool(range(FIRST, FIRST + size.hearts), beating=True), torch.arange(size.rows)
    whose, seeds = each % size.hearts, sample_seeds(0, size.rows)
    nominal = pool.targets(whose)
    pose = Pose(nominal.position[each, each % 5], nominal.rotation[each, each % 5])
    generator = torch.Generator().manual_seed(0)
    phase = torch.rand((size.rows, 2), generator=generator).double()

    def draw(pool: Pool = pool) -> Tensor:
        return pool.render(pose, whose, phase, seeds)

    ways = {
        f"{n} at a time": while_set(draw, replaced(pools, "CHUNK", {"cpu": n})) for n in size.chunks
    }
    ways |= of_threads(draw)
    for name, kind in HALVES.items():
        other = copy.copy(pool)
        other.__dict__["_voxels"] = halved(pool._voxels, kind)
        change = replaced(patients, "_echoes", packed_as(patients._echoes, name))
        ways[f"scatterers in {name}"] = while_set(lambda other=other: draw(other), change)
    world = World(draw, ways, {}, {})
    compiled(world, pools, "place_samples", size)
    compiled(world, pools, "hear", size)
    return world


def of_threads(draw: Callable[[], Tensor]) -> dict[str, Callable[[], Tensor]]:
    """Return drawing with one and with two threads, whichever is not today's."""
    names = {1: "one thread", 2: "two threads"}
    return {
        name: while_set(draw, lambda count=count: threads(count))
        for count, name in names.items()
        if count != torch.get_num_threads()
    }


def packed_as(function: Callable[..., Any], kind: str) -> Callable[..., Any]:
    """Return sampling that reads scatterers as another type of two bytes."""
    return rewritten(
        function, scatterers=("packed.view(torch.int16)", f"packed.view(torch.{kind})")
    )


def halved(packed: Tensor, kind: torch.dtype) -> Tensor:
    """Return voxels whose scatterers are of a half-precision type, in the same two bytes."""
    parts = packed.view(torch.int16).view(-1, 4).clone()
    parts[:, :2] = parts[:, :2].to(kind).view(torch.int16)
    return parts.view(torch.int64).flatten()


def columns(packed: Tensor, kind: torch.dtype) -> Tensor:
    """Return (N, 6) voxels: scatterers, impedance gradient and attenuation, nothing to unpack."""
    scatterers = packed.view(torch.int16).view(-1, 4)[:, :2]
    gradient = packed.view(torch.int8).view(-1, 8)[:, 4:7]
    attenuation = packed.view(torch.uint8).view(-1, 8)[:, 7:]
    return torch.cat([part.to(kind) for part in (scatterers, gradient, attenuation)], 1)


def unpacked(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return sampling that reads the six columns of `columns`."""
    return rewritten(
        function,
        attenuation=("packed.view(torch.uint8).view(*index.shape, 8)[..., 7]", "packed[..., 5]"),
        read=("index.flatten())", "index.flatten()).view(*index.shape, 6)"),
        scatterers=("packed.view(torch.int16).view(*index.shape, 4)", "packed"),
        levels=("packed.view(torch.int8).view(*index.shape, 8)", "packed[..., 2:5]"),
        x=("levels[..., 4]", "levels[..., 0]"),
        y=("levels[..., 5]", "levels[..., 1]"),
        z=("levels[..., 6]", "levels[..., 2]"),
    )


def compiled(world: World, owner: Any, function: str, size: Size) -> None:
    """Add a way in which a function is compiled, or why it is not."""
    if not size.patience:
        return
    quick = torch.compile(getattr(owner, function), dynamic=False)
    draw, name = while_set(world.today, replaced(owner, function, quick)), f"`{function}` compiled"
    began, why = time.perf_counter(), ""
    try:
        with alarm(size.patience), config.patch(force_disable_caches=True):
            draw()
    except Exception as error:  # a compiler may wrap the alarm in an error of its own
        why = f"by torch: {type(error).__name__}"
    took = time.perf_counter() - began
    if took >= size.patience:  # or let it pass
        why = f"within {size.patience:g} s"
    if why:
        world.failed[name] = f"not compiled {why}"
    else:
        world.ways[name], world.prepared[name] = draw, took


@contextmanager
def alarm(seconds: float) -> Iterator[None]:
    """Raise `TimeoutError` after some time."""

    def ring(*told: object) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def measure(world: World, size: Size) -> dict[str, Any]:
    """Return how many times as quick as today's each way is, and how far its pixels lie off."""
    images = world.today().int()
    apart = {name: int((draw().int() - images).abs().max()) for name, draw in world.ways.items()}
    times = in_turns({TODAY: world.today, **world.ways}, size.rounds)
    told: dict[str, Any] = {TODAY: {"seconds": median(times[TODAY])}}
    for name, gray in apart.items():
        each = ratios(times[TODAY], times[name])
        told[name] = {"ratio": median(each), "low": min(each), "high": max(each), "apart": gray}
        if name in world.prepared:
            told[name]["prepared_seconds"] = world.prepared[name]
    return told | {name: {"failed": why} for name, why in world.failed.items()}


def verdict(told: dict[str, Any], allowed: int) -> str:
    """Return in words whether a way pays."""
    if "failed" in told:
        return told["failed"]
    if told["ratio"] < GAIN or told["low"] < 1.0:
        return "does not pay"
    if told["apart"] > allowed:
        return "quicker, but other pictures"
    return f"pays, after {told['prepared_seconds']:.0f} s" if "prepared_seconds" in told else "pays"


def table(measured: dict[str, Any]) -> dict[str, Any]:
    """Return all ways as the documentation shows them."""
    rows = []
    for world, ways in measured.items():
        for name, told in ways.items():
            if name == TODAY:
                continue
            times = " – ".join(
                f"{told[key]:.2f}" for key in ("low", "ratio", "high") if key in told
            )
            gray = str(told.get("apart", "–"))
            rows.append([world, name, times or "–", gray, verdict(told, ALLOWED[world])])
    heads = ["drawn", "way", "times as quick: least – median – most", "gray levels apart, at most",
             "verdict"]  # fmt: skip
    return {"columns": heads, "rows": rows}


def document(size: Size, out: Path | str) -> dict[str, Any]:
    """Return the file of what was tried."""
    makers = {HEART: of_heart, PATIENTS: of_patients}
    measured = {name: measure(make(size), size) for name, make in makers.items()}
    where = environment("cpu")
    count = where["threads"]
    told = f"{where['cpu']}, {count} thread{'s' if count > 1 else ''}, torch {where['torch']}"
    return {
        "schema": "racines.figures/1",
        "what": f"ways of drawing {size.rows} frames beside today's, in turns in one process",
        "command": f"OMP_NUM_THREADS={count} python -m tests.benchmarks.tried {out}",
        "machine": told,
        "source": "measured once",
        "measured": measured,
        "tables": {"tried": table(measured)},
    }


if __name__ == "__main__":
    place = Path(sys.argv[1])
    write_json(place, content := document(Size(), place))
    for row in [content["tables"]["tried"]["columns"], *content["tables"]["tried"]["rows"]]:
        print(" | ".join(row))
