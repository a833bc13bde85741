"""Speed and memory of the data build, beside writing the same frames with plain `datasets`.

The peer draws the same sweeps by the same renderer and hands them, a row a frame, to
`Dataset.from_generator`, then writes Parquet; both in one process of one thread, since a fork of a
process with threads may wait for ever. Ours does more in its time: splits, checks, digests, a card
with pictures, and a store for training. Rows are compared, value for value, of the first builds
that were timed: another pair would take as long again.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from datasets import Dataset, concatenate_datasets

import racines_data
from racines_data.build.dataset import DataConfig, build, make_source
from racines_data.phantom import shared_phantom
from racines_data.schema import CONTROLS, PARAMETERS, frame_features
from tests.benchmarks.lines import line_of
from tests.benchmarks.turns import in_turns

FRAMES = int(os.environ.get("RACINES_BUILD_FRAMES", "6000"))
ROWS = 200
PEER = "datasets, from_generator and to_parquet"


def rows(units: list[Any], config: DataConfig) -> Iterator[dict[str, Any]]:
    """Yield a row a frame of some sweeps, as a user of `datasets` would."""
    source = make_source(config)
    for unit in units:
        sweep = source.produce(unit)
        for t in range(len(sweep)):
            row: dict[str, Any] = {"image": sweep.images[t], "timestamp": sweep.timestamps[t]}
            row |= dict(zip(PARAMETERS, sweep.parameters[t], strict=True))
            row |= dict(zip(CONTROLS, sweep.controls[t], strict=True))
            row |= {"view": sweep.views[t], "grade": sweep.grades[t], "source": "phantom"}
            row |= {"view_predicted": None, "grade_predicted": None, "phantom": sweep.phantom}
            row |= {"target_view": sweep.target_view, "session": sweep.session}
            yield row | {"trajectory": sweep.id, "frame": t}


def plain(config: DataConfig, folder: Path) -> None:
    """Write the frames with `datasets` alone."""
    dataset = Dataset.from_generator(
        rows, features=frame_features(("phantom",)), cache_dir=str(folder / "cache"),
        gen_kwargs={"units": list(make_source(config).plan()), "config": config},
    )  # fmt: skip
    dataset.to_parquet(folder / "frames.parquet")  # type: ignore[union-attr]


@pytest.mark.timeout(900)
@pytest.mark.slow
def test_build(benchmark, line, tmp_path: Path) -> None:
    config, threads = DataConfig(frames=FRAMES, workers=1), torch.get_num_threads()
    torch.set_num_threads(1)
    shared_phantom()  # baked for both
    places = {name: [] for name in ("ours", PEER)}

    def place(name: str) -> Path:
        folder = tmp_path / f"{name[:4]}{len(places[name])}"
        places[name].append(folder)
        folder.mkdir()
        return folder

    sides = {
        "ours": lambda: build(make_source(config), place("ours") / "racines", config),
        PEER: lambda: plain(config, place(PEER)),
    }
    times = in_turns(sides, rounds=2, warm=0)
    assert_equal(places["ours"][0] / "racines", places[PEER][0] / "frames.parquet")
    benchmark.pedantic(sides["ours"], rounds=1)
    torch.set_num_threads(threads)
    work = f"build, {FRAMES:,} frames, one process"
    line(line_of(work, "frames/s", FRAMES, times, PEER, f"columns, and {ROWS} rows"))


def assert_equal(ours: Path, peers: Path) -> None:
    """Check that both have the same rows, of which some are compared value for value."""
    loaded = racines_data.load(root=ours)
    mine = concatenate_datasets([loaded[split] for split in loaded])
    theirs = Dataset.from_parquet(str(peers))
    assert len(mine) == len(theirs)  # type: ignore[arg-type]
    where = {
        key: i for i, key in enumerate(zip(theirs["trajectory"], theirs["frame"], strict=True))
    }
    assert set(mine.column_names) == set(theirs.column_names)  # type: ignore[union-attr]
    for i in np.random.default_rng(0).choice(len(mine), ROWS, replace=False).tolist():
        one = mine[i]
        other = theirs[where[one["trajectory"], one["frame"]]]  # type: ignore[index]
        assert np.array_equal(np.asarray(one.pop("image")), np.asarray(other.pop("image")))
        assert one.keys() == other.keys()
        for name, value in one.items():
            assert value == other[name] or (value != value and other[name] != other[name]), name
