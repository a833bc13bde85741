"""Speed of the training store: shuffled batches of 256, beside its two peers in the same run.

- `datasets` with `.with_format("torch")`, item by item in the same order, restricted to the columns
  that a batch has; timed on the first 512 items, since a whole pass takes too long.
- a memcpy of the same bytes: `copy_` of as many contiguous frames from a plain tensor in main
  memory into one that is used again and again. Nothing that reads the bytes can be quicker.

All sides are warm: files in the page cache, one pass of each before the clock starts. Every run
takes the three in turn, and each ratio is the median of the runs.
"""

import statistics
import time
from collections.abc import Callable

import pytest
import torch

import racines_data
from racines_data.build.dataset import DataConfig, build, make_source
from racines_data.schema import PARAMETERS
from racines_data.store.frames import FrameStore

FRAMES = 12_000
BATCH = 256
ITEMS = 512
RUNS = 5


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> FrameStore:
    root = tmp_path_factory.mktemp("loader") / "racines"
    config = DataConfig(frames=FRAMES)
    build(make_source(config), root, config)
    return FrameStore(root)


@pytest.mark.timeout(900)
@pytest.mark.slow
def test_shuffled_batches_of_256(benchmark, store: FrameStore) -> None:
    benchmark.pedantic(lambda: ours(store, 0), rounds=RUNS, warmup_rounds=1)
    rows = racines_data.load(root=store.root, split="train")
    rows = rows.select_columns(["image", *PARAMETERS, "view", "grade"]).with_format("torch")
    plain, kept = store.images.clone(), store.images[:BATCH].clone()
    seconds: dict[str, list[float]] = {"ours": [], "datasets": [], "memcpy": []}
    for run in range(RUNS + 1):
        order = ours(store, run)
        figures = {
            "ours": clock(ours, store, run) / len(order),
            "memcpy": clock(memcpy, plain, kept, len(order)) / len(order),
            "datasets": clock(item_by_item, rows, order[:ITEMS].tolist()) / ITEMS,
        }
        if run:  # the first warms up
            for name, each in figures.items():
                seconds[name].append(each)
    assert_equal(store, rows)
    peers = {name: ratios(seconds[name], seconds["ours"]) for name in ("datasets", "memcpy")}
    print({name: [round(each, 3) for each in runs] for name, runs in peers.items()})
    benchmark.extra_info.update({f"times_{name}": runs for name, runs in peers.items()})
    benchmark.extra_info["frames_per_second"] = 1 / statistics.median(seconds["ours"])
    assert statistics.median(peers["datasets"]) >= 100
    assert statistics.median(peers["memcpy"]) >= 0.5


def ours(store: FrameStore, seed: int) -> torch.Tensor:
    """Take one shuffled pass; return the rows in the order they came, counted from the split."""
    start, _ = store.bounds("train")
    return torch.cat([batch.index - start for batch in store.batches("train", BATCH, seed)])


def memcpy(plain: torch.Tensor, kept: torch.Tensor, frames: int) -> None:
    starts = torch.randperm(frames // BATCH) * BATCH
    for start in [*starts.tolist(), frames // BATCH * BATCH]:
        count = min(BATCH, frames - start)
        kept[:count].copy_(plain[start : start + count])


def item_by_item(rows, items: list[int]) -> None:
    for index in items:
        rows[index]


def clock(work: Callable, *arguments) -> float:
    start = time.perf_counter()
    work(*arguments)
    return time.perf_counter() - start


def ratios(peer: list[float], own: list[float]) -> list[float]:
    return [theirs / mine for theirs, mine in zip(peer, own, strict=True)]


def assert_equal(store: FrameStore, rows) -> None:
    """Check that a batch holds what the items of the other library hold, value for value."""
    batch = next(store.batches("train", BATCH, seed=1))
    start, _ = store.bounds("train")
    for place, index in enumerate((batch.index - start).tolist()):
        item = rows[index]
        assert torch.equal(item["image"].squeeze(), batch.images[place])
        values = torch.stack([item[name] for name in PARAMETERS])
        assert torch.equal(values, batch.parameters[place])
        assert item["view"] == batch.views[place] and item["grade"] == batch.grades[place]
