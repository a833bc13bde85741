"""Speed of the training store: shuffled batches of 256, beside three peers in the same run.

- `datasets` with `.with_format("torch")`, item by item in the same order, restricted to the columns
  that a batch has; timed on the first 512 items, since a whole pass takes too long.
- PyTorch's `DataLoader` on the same frames as PNG files with their numbers in memory, as tutorials
  have it, two workers; timed on its first eight batches, the start of its workers left out.
- a memcpy of the same bytes: `copy_` of as many contiguous frames from a plain tensor in main
  memory into one that is used again and again. Nothing that reads the bytes can be quicker.

Values of a batch are compared before the clock starts.
All sides are warm: files in the page cache, one pass of each before the clock starts. Every run
takes them in turn, and each ratio is the median of the runs.
"""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from torch.utils.data import DataLoader, Dataset

import racines_data
from racines_data.build.dataset import DataConfig, build, make_source
from racines_data.schema import PARAMETERS
from racines_data.store.frames import FrameStore
from tests.benchmarks.lines import line_of
from tests.benchmarks.turns import Times

FRAMES = 12_000
BATCH = 256
ITEMS = 512
PNGS = 9 * BATCH
RUNS = 5
ITEMWISE, PNG = 'datasets, with_format("torch")', "DataLoader on PNG files, 2 workers"
MEMCPY = "memcpy"


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> FrameStore:
    root = tmp_path_factory.mktemp("loader") / "racines"
    config = DataConfig(frames=FRAMES)
    build(make_source(config), root, config)
    return FrameStore(root)


@pytest.mark.timeout(900)
@pytest.mark.slow
def test_shuffled_batches_of_256(benchmark, line, store: FrameStore, tmp_path: Path) -> None:
    rows = racines_data.load(root=store.root, split="train")
    rows = rows.select_columns(["image", *PARAMETERS, "view", "grade"]).with_format("torch")
    plain, kept = store.images.clone(), store.images[:BATCH].clone()
    files = Files(store, tmp_path)
    assert_equal(store, rows)
    assert_files_equal(store, files)
    loader = DataLoader(files, BATCH, shuffle=True, num_workers=2, persistent_workers=True)
    seconds: Times = {"ours": [], ITEMWISE: [], PNG: [], MEMCPY: []}
    for run in range(RUNS + 1):
        order = ours(store, run)
        figures = {
            "ours": clock(ours, store, run) / len(order),
            MEMCPY: clock(memcpy, plain, kept, len(order)) / len(order),
            ITEMWISE: clock(item_by_item, rows, order[:ITEMS].tolist()) / ITEMS,
            PNG: loaded(loader),
        }
        if run:  # the first warms up
            for name, each in figures.items():
                seconds[name].append(each)
    benchmark.pedantic(lambda: ours(store, 0), rounds=RUNS, warmup_rounds=1)
    work = f"shuffled batches of {BATCH}"
    values = "values of a batch"
    for peer, aim, equal in (
        (ITEMWISE, 100.0, values),
        (PNG, None, values),
        (MEMCPY, 0.5, "bytes moved"),
    ):
        one = line_of(work, "frames/s", 1, seconds, peer, equal, aim)
        line(one)
        assert aim is None or one.ratio >= aim, one


class Files(Dataset):
    """Frames of the train split as PNG files, their numbers in memory."""

    def __init__(self, store: FrameStore, folder: Path) -> None:
        """Write the first `PNGS` frames."""
        start, _ = store.bounds("train")
        self.paths = [folder / f"{i}.png" for i in range(PNGS)]
        for i, path in enumerate(self.paths):
            Image.fromarray(store.images[start + i].numpy()).save(path)
        here = slice(start, start + PNGS)
        self.numbers = store.parameters[here], store.views[here], store.grades[here]

    def __len__(self) -> int:
        return PNGS

    def __getitem__(self, index: int) -> tuple[torch.Tensor, ...]:
        with Image.open(self.paths[index]) as image:
            pixels = torch.from_numpy(np.asarray(image).copy())
        return pixels, *(each[index] for each in self.numbers)


def loaded(loader: DataLoader) -> float:
    """Return the seconds a frame of a pass, from its first batch on."""
    batches = iter(loader)
    next(batches)
    start = time.perf_counter()
    count = sum(len(batch[0]) for batch in batches)
    return (time.perf_counter() - start) / count


def assert_files_equal(store: FrameStore, files: Files) -> None:
    """Check that the files hold what a batch holds, value for value."""
    start, _ = store.bounds("train")
    batch = next(store.batches("train", BATCH, seed=1))
    for place, index in enumerate((batch.index - start).tolist()):
        if index < PNGS:
            pixels, parameters, view, grade = files[index]
            assert torch.equal(pixels, batch.images[place])
            assert torch.equal(parameters, batch.parameters[place])
            assert view == batch.views[place] and grade == batch.grades[place]


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
