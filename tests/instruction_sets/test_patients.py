"""Patients are the same on every processor: the golden frames by instruction set."""

import os
import subprocess
import sys
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.instruction_sets.golden_frames import ONEDNN
from tests.instruction_sets.test_contracts import LEVELS, ROOT

EQUAL = 0.999
"""Least share of pixels that are the same to the last bit."""


@pytest.mark.instruction_sets
def test_five_patients_are_drawn_alike(tmp_path: Path, hearts: Path) -> None:
    """To one gray level, and nearly all to the last bit; masks are the same."""
    own = LEVELS.get(torch.backends.cpu.get_cpu_capability(), 0)
    names = [name for name in ONEDNN if LEVELS[name.upper()] <= own]
    done = subprocess.run(
        [sys.executable, "-m", "tests.instruction_sets.golden_frames", str(tmp_path), *names[::-1]],
        cwd=ROOT, env=os.environ | {"XDG_CACHE_HOME": str(hearts)},
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    drawn = {name: np.load(tmp_path / f"{name}.npz") for name in names}
    assert {name: str(found["took"]) for name, found in drawn.items()} == {n: n for n in names}
    for (one, first), (other, second) in combinations(drawn.items(), 2):
        off = np.abs(first["images"].astype(int) - second["images"].astype(int))
        equal = float((off == 0).mean())
        print(f"{one}, {other}: {equal:.3%} of pixels are equal")
        assert off.max() <= 1, f"{one}, {other}: {(off > 1).sum()} pixels, by {off.max()} at most"
        assert equal >= EQUAL, f"{one}, {other}: only {equal:.3%} of pixels are equal"
        assert np.array_equal(first["masks"], second["masks"]), f"masks, {one}, {other}"
