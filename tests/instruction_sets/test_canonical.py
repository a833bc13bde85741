"""One version is the same data on every processor: canonical frames by instruction set.

PyTorch's own choice reaches the renderer; oneDNN's does not, since the phantom has no network.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from racines_data.validate.canonical import LEVELS
from tests.instruction_sets.test_contracts import LEVELS as SETS

ROOT = Path(__file__).parents[2]
COMMAND = "from racines_leaderboard.cli.command import main; main()"


def draw(**environment: str) -> dict:
    """Draw the canonical frames in a process of their own; return the comparison."""
    words = ["study", "processors", "--json"]
    done = subprocess.run(
        [sys.executable, "-c", COMMAND, *words],
        cwd=ROOT, env=os.environ | environment, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return json.loads(done.stdout)


@pytest.mark.instruction_sets
@pytest.mark.timeout(3000)
@pytest.mark.parametrize(
    "name", [pytest.param("default", marks=pytest.mark.thorough), "avx2", "avx512"]
)
def test_canonical_frames_are_those_of_every_processor_on_record(name: str) -> None:
    if SETS.get(torch.backends.cpu.get_cpu_capability(), 0) < SETS[name.upper()]:
        pytest.skip(f"this CPU has no {name}")
    report = draw(ATEN_CPU_CAPABILITY=name)
    assert report["here"]["instructions"] == name.upper()
    pairs = [pair for pair in report["pairs"] if pair["here"]]
    assert len(pairs) >= 3 and report["holds"]
    assert all(pair["levels"] <= LEVELS and pair["holds"] for pair in pairs)
    for pair in pairs:  # on the processor that drew a set, it is drawn again to the last byte
        alike = ("cpu", "instructions", "torch")
        if all(pair["one"][key] == pair["other"][key] for key in alike):
            assert pair["differing"] == 0


@pytest.mark.instruction_sets
@pytest.mark.thorough
@pytest.mark.timeout(3000)
def test_what_onednn_takes_does_not_reach_the_renderer() -> None:
    own, other = draw(), draw(ONEDNN_MAX_CPU_ISA="SSE41")
    assert own["here"] == other["here"]
