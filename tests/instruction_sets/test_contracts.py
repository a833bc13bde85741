"""The contracts on other instruction sets than the machine's own, in processes of their own.

Which code oneDNN, MKL and PyTorch take is decided once a process. The machine's own choice is
tested where the contracts stand.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).parents[2]
QUICK = [
    "tests/instruction_sets/test_rows.py",
    "tests/models/generators/test_flow.py",
    "tests/envs/patients/test_memory.py",
]
"""Tests marked `contract` of published weights, of a network with attention, and of a memory."""
TESTS = [
    *QUICK,
    "tests/models/generators/test_gan_roster.py",
    "tests/models/generators/test_generators.py",
    "tests/models/generators/test_noise_ceiling.py",
    "tests/models/generators/test_scene_field.py",
    "tests/models/exchange/test_onnx.py",
    "tests/envs/agents/test_agents.py",
]
"""All tests so marked: those of tiny networks as well."""
LEVELS = {"DEFAULT": 0, "AVX2": 1, "AVX512": 2}
SETTINGS = {
    "avx2": (1, {"ONEDNN_MAX_CPU_ISA": "AVX2", "ATEN_CPU_CAPABILITY": "avx2"}),
    "avx512": (2, {"ONEDNN_MAX_CPU_ISA": "AVX512_CORE", "ATEN_CPU_CAPABILITY": "avx512"}),
}


@pytest.mark.instruction_sets
@pytest.mark.timeout(3000)  # each is some hundred tests on one core, however busy
@pytest.mark.parametrize(
    ("name", "tests"),
    [
        pytest.param("avx2", QUICK, id="avx2"),
        pytest.param("avx2", TESTS, id="avx2-all", marks=pytest.mark.thorough),
        # Who has AVX-512 has taken it in the other tests, but for newer parts of oneDNN: each week.
        pytest.param("avx512", TESTS, id="avx512", marks=pytest.mark.thorough),
    ],
)
def test_contracts_hold_with(name: str, tests: list[str]) -> None:
    needed, environment = SETTINGS[name]
    if LEVELS.get(torch.backends.cpu.get_cpu_capability(), 0) < needed:
        pytest.skip(f"this CPU has no {name}")
    command = [sys.executable, "-m", "pytest", "-n", "0", "-m", "contract", *tests]
    done = subprocess.run(
        command, cwd=ROOT, env=os.environ | environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
