"""Compiled steps: those of the core, to a rounding; what they refuse."""

import os
import subprocess
import sys

import pytest
import torch

from racines_data.errors import RacinesError
from racines_envs.worlds.making import make_core
from tests.variants import first_of

TASKS = ["SC", "AnyView-beating"]
ROWS, STEPS = 6, 40
CAPABILITY = torch.backends.cpu.get_cpu_capability()
CLOSE = 1e-4
"""How far numbers may lie from each other, rewards and newtons too."""


@pytest.fixture
def traced(monkeypatch):
    """Compile by tracing alone: the same graphs, run as they are, in a fraction of the time."""
    compile = torch.compile
    monkeypatch.setattr(torch, "compile", lambda f, **k: compile(f, **k, backend="eager"))


def assert_alike(view: str, **settings) -> None:
    how = {"observation": "params", "reward": "shaped"} | settings
    cores = [make_core(view, ROWS, **how, compile=each) for each in (False, True)]
    for core in cores:
        core.reset(seed=3)
    draw = torch.Generator().manual_seed(0)
    for step in range(STEPS):
        action = torch.randint(0, 13, (ROWS,), generator=draw)
        plain, quick = (core.step(action, autoreset=True) for core in cores)
        assert torch.equal(plain.terminated, quick.terminated), step
        assert torch.equal(plain.truncated, quick.truncated), step
        pairs = [(plain.reward, quick.reward)]
        pairs += [(plain.observation[key], quick.observation[key]) for key in plain.observation]
        told, other = (core.info(False) for core in cores)
        assert list(told) == list(other)
        pairs += [(told[key], other[key]) for key in told]
        for one, two in pairs:
            torch.testing.assert_close(one, two, atol=CLOSE, rtol=0, equal_nan=True)


@pytest.mark.parametrize("view", first_of(TASKS))
def test_steps_are_those_of_the_core(traced, view):
    assert_alike(view, termination="declared" if view != "SC" else "k_hits")


@pytest.mark.thorough
@pytest.mark.parametrize("view", TASKS)
def test_compiled_code_gives_the_steps_of_the_core(view):
    assert_alike(view)


@pytest.mark.thorough
@pytest.mark.skipif(CAPABILITY != "AVX512", reason="needs two instruction sets with vectors")
def test_code_that_is_kept_serves_no_other_instruction_set(tmp_path):
    """A folder of compiled code may be shared: with the width of other vectors all is wrong."""
    one = "test_compiled_code_gives_the_steps_of_the_core[SC]"
    for capability in ("avx512", "avx2"):
        kept = {"TORCHINDUCTOR_CACHE_DIR": str(tmp_path), "ATEN_CPU_CAPABILITY": capability}
        command = [sys.executable, "-m", "pytest", "-q", "-n", "0", f"{__file__}::{one}"]
        done = subprocess.run(command, env=os.environ | kept, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout[-2000:]


def test_the_width_of_vectors_is_part_of_what_code_is_stored_by():
    from torch._inductor import config, cpu_vec_isa

    with config.patch({"cpp.simdlen": None}):
        before = config.get_hash()
        make_core("SC", 2, observation="params", reward="shaped", compile=True)
        assert config.cpp.simdlen == cpu_vec_isa.pick_vec_isa().bit_width()
        assert config.get_hash() != before


def test_a_bad_action_costs_no_episode(traced):
    cores = [
        make_core("SC", 2, observation="params", reward="shaped", compile=each)
        for each in (False, True)
    ]
    for core in cores:
        core.reset(seed=1)
        core.state.done = torch.tensor([True, False])
        with pytest.raises(RacinesError, match="action"):
            core.step(torch.tensor([0, 13]), autoreset=True)
        core.step(torch.tensor([0, 12]), autoreset=True)
    assert torch.equal(cores[0].state.seed, cores[1].state.seed)


def test_rows_that_are_reset_alone_go_on_as_the_cores(traced):
    cores = [
        make_core("SC", 3, observation="params", reward="oracle", compile=each)
        for each in (False, True)
    ]
    mask, action = torch.tensor([False, True, False]), torch.tensor([0, 4, 9])
    for core in cores:
        core.reset(seed=1)
        core.step(action)
        core.reset(mask=mask)
    told, other = (core.info(False) for core in cores)  # of the new episode, not of the last step
    assert told["steps"].tolist() == other["steps"].tolist() == [1, 0, 1]
    plain, quick = (core.step(action, rows=torch.tensor([1])).observation for core in cores)
    torch.testing.assert_close(plain["params"], quick["params"], atol=CLOSE, rtol=0)
    assert cores[1].state.steps.tolist() == [1, 1, 1]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"observation": "image", "reward": "oracle"}, "draws images.*leave compile out"),
        ({"observation": "params", "robot": "ur5e"}, "cannot compile the steps of this task"),
    ],
)
def test_what_is_not_compiled_is_refused(traced, settings, message):
    with pytest.raises(RacinesError, match=message):
        core = make_core("SC", 2, **{"reward": "shaped", **settings}, compile=True)
        core.reset(seed=0)
        core.step(torch.zeros(2, dtype=torch.long))


def test_without_a_compiler_it_says_so_at_once(monkeypatch):
    from torch._inductor import cpp_builder, exc

    def missing(*_):
        raise exc.InvalidCxxCompiler()

    monkeypatch.setattr(cpp_builder, "get_cpp_compiler", missing)
    with pytest.raises(RacinesError, match="compile: no C\\+\\+ compiler was found"):
        make_core("SC", 2, observation="params", reward="shaped", compile=True)
