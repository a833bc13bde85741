"""The determinism report: what differs is seen, what does not is not."""

import json
import multiprocessing
import os
import signal
import subprocess
import sys

import psutil
import pytest
import torch

from racines_data.errors import RacinesError
from racines_leaderboard.cli.audit import determinism
from racines_leaderboard.determinism import run as module
from racines_leaderboard.determinism.processes import ATEN, LEVELS, ONEDNN, Processes, own_level
from racines_leaderboard.determinism.run import (
    cell,
    compare_stage,
    determinism_markdown,
    differences,
    measure,
    unrepeated,
)
from racines_leaderboard.determinism.stages import Setup, Stage, Work, in_batches, threads
from tests.conftest import ROOT
from tests.waiting import until


def test_differences_are_measured():
    a = {
        "x": torch.tensor([1.0, 2.0, 3.0, float("nan")]),
        "y": torch.tensor([0], dtype=torch.uint8),
    }
    assert differences(a, {key: value.clone() for key, value in a.items()}) == (True, 0.0, 0.0)
    b = {
        "x": torch.tensor([1.0, 2.5, 3.0, float("nan")]),
        "y": torch.tensor([255], dtype=torch.uint8),
    }
    assert differences(a, b) == (False, 255.0, 0.4)
    one = {"x": torch.tensor([float("nan")])}
    assert differences(one, {"x": torch.tensor([0.0])}) == (False, float("inf"), 1.0)
    with pytest.raises(ValueError, match="other names"):
        differences(a, {"x": a["x"]})


def test_a_stage_is_run_as_it_is_asked_to(tmp_path):
    seen: list[Setup] = []

    def make(work: Work, setup: Setup):
        seen.append(setup)
        assert torch.get_num_threads() == setup.threads
        rows = torch.arange(4.0)
        # Depends on the batch, as a stage must not.
        return {"a": in_batches(lambda r: rows[r] - rows[r].mean(), min(setup.batch, 4), 4)}

    stage = Stage("made up", "units", make, ("again", "threads", "batch"))
    twice, more, single = compare_stage(stage, Work(tmp_path), Processes(tmp_path))
    assert twice.bitwise and more.bitwise and not single.bitwise
    assert (single.largest, single.share) == (1.5, 1.0)
    assert [each.batch for each in seen] == [64, 64, 64, 1]


def test_what_is_not_to_be_had_is_said(tmp_path, monkeypatch):
    def make(work: Work, setup: Setup):
        if setup.device == "onnx":
            raise RacinesError("no ONNX of it")
        return {"a": torch.zeros(1)}

    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    stage = Stage("made up", "units", make, ("onnx", "cuda"))
    monkeypatch.setattr(module, "stages", lambda: [stage])
    document = measure()
    assert [each["note"] for each in document["outcomes"]] == [
        "no ONNX of it",
        "no CUDA device here",
    ]
    assert json.loads(json.dumps(document)) == document
    assert "| made up | – | – |" in determinism_markdown(document)
    assert cell(document["outcomes"][0]) == "–"
    with pytest.raises(RacinesError, match="no stage nothing: choose among made up"):
        measure(["nothing"])


@pytest.mark.thorough
def test_a_real_stage_repeats_itself(tmp_path, capsys):
    determinism(["mean-image, drawing"], tmp_path / "report.json", as_json=False)
    document = json.loads((tmp_path / "report.json").read_text())
    told = {each["compared"]: each["bitwise"] for each in document["outcomes"]}
    assert told["twice"] and told["two processes"] and told["1 and 2 threads"]
    assert told["batch 64 and 1"] and told["ATen default"] is (True if own_level() else None)
    assert "| mean-image, drawing | bitwise | bitwise | bitwise |" in capsys.readouterr().out
    assert document["schema"] == "racines.determinism/2"


def test_a_killed_run_goes_on(tmp_path, monkeypatch):
    runs: list[str] = []

    def stage(name: str, fault: bool) -> Stage:
        def make(work: Work, setup: Setup):
            runs.append(name)
            if fault:
                raise KeyboardInterrupt
            return {"a": torch.zeros(1)}

        return Stage(name, "units", make, ("again",))

    out = tmp_path / "report.json"
    monkeypatch.setattr(module, "stages", lambda: [stage("one", False), stage("two", True)])
    with pytest.raises(KeyboardInterrupt):
        measure(out=out)
    monkeypatch.setattr(module, "stages", lambda: [stage("one", False), stage("two", False)])
    document = measure(out=out)
    assert [each["stage"] for each in document["outcomes"]] == ["one", "two"]
    assert runs == ["one", "one", "two", "two", "two"]
    told = json.loads(out.read_text())
    told["environment"]["cpu"] = "another"
    out.write_text(json.dumps(told))
    measure(out=out)
    assert len(runs) == 9, "what another machine measured is measured again"


def test_threads_are_given_back():
    before = torch.get_num_threads()
    with pytest.raises(KeyError), threads(before + 1):
        raise KeyError
    assert torch.get_num_threads() == before


def by_process(work: Work, setup: Setup):
    """Depends on the process, as a stage must not."""
    return {"a": torch.tensor([float(os.getpid())])}


def by_instructions(work: Work, setup: Setup):
    """Tells what the process was given, and which code PyTorch took for it."""
    level = LEVELS[torch.backends.cpu.get_cpu_capability()]
    limit = {None: 0.0, "AVX2": 2.0}.get(os.environ.get(ONEDNN), 1.0)
    return {"level": torch.tensor([float(level)]), "limit": torch.tensor([limit])}


def die(work: Work, setup: Setup):
    """Ends the process in which it is not the first."""
    if multiprocessing.parent_process() is not None:
        os._exit(1)
    return {"a": torch.zeros(1)}


@pytest.fixture
def processes(tmp_path):
    with Processes(tmp_path) as running:
        yield running


@pytest.mark.thorough
def test_a_stage_that_differs_from_process_to_process_is_seen(tmp_path, processes, monkeypatch):
    stage = Stage("made up", "units", by_process, ("again", "process"))
    again, process = compare_stage(stage, Work(tmp_path), processes)
    assert again.bitwise and not process.bitwise
    monkeypatch.setattr(module, "stages", lambda: [stage])
    assert unrepeated(measure()) == ["made up (two processes)"]
    with pytest.raises(RacinesError, match="not the same bytes a second time: made up"):
        determinism([], None, as_json=True)


SETS = ("process", "aten-default", "aten-avx2", "aten-avx512", "onednn-avx2")
QUICK = tuple(each for each in SETS if each != "aten-avx2" or own_level() == LEVELS["AVX2"])
"""Without the second set below the processor's own, which would take one more process."""


@pytest.mark.parametrize(
    "sets", [QUICK, pytest.param(SETS, marks=pytest.mark.thorough)], ids=["quick", "all"]
)
def test_a_process_takes_the_instructions_that_it_is_told(tmp_path, processes, sets):
    stage = Stage("made up", "levels", by_instructions, sets)
    told = {each.compared: each for each in compare_stage(stage, Work(tmp_path), processes)}
    assert told["two processes"].bitwise
    assert ATEN not in os.environ and ONEDNN not in os.environ, "this process is left as it was"
    levels = {"ATen default": 0, "ATen AVX2": 1, "ATen AVX-512": 2}
    assert len(told) == len(sets)
    for name, level in ((name, level) for name, level in levels.items() if name in told):
        if level < own_level():
            assert told[name].largest == own_level() - level
        else:
            own = level == own_level()
            assert told[name].bitwise is None and (told[name].note == module.OWN) is own
            assert cell(vars(told[name])) == ("own" if own else "–")
    if own_level() >= LEVELS["AVX2"]:
        assert told["oneDNN AVX2"].largest == 2.0


def test_a_variable_that_has_no_effect_is_no_comparison(tmp_path, processes):
    stage = Stage("made up", "levels", by_instructions, ())
    with pytest.raises(RacinesError, match="ATEN_CPU_CAPABILITY=sse9: PyTorch took"):
        processes.run(stage, Setup(), {ATEN: "sse9"})


def test_a_process_that_dies_is_told_and_no_repetition(tmp_path, monkeypatch):
    stage = Stage("made up", "units", die, ("again", "process"))
    monkeypatch.setattr(module, "stages", lambda: [stage])
    document = measure()
    again, process = document["outcomes"]
    assert (
        again["bitwise"] and process["bitwise"] is None and "its process ended" in process["note"]
    )
    assert unrepeated(document) == ["made up (two processes)"]


def test_all_processes_start_from_the_same_inputs(tmp_path):
    """A generator that one process fitted is opened by the next, not fitted again."""
    one, two = Work(tmp_path), Work(tmp_path)
    weights = [each.generator("mean-image").tensors() for each in (one, two)]
    assert weights[0].keys() == weights[1].keys()
    assert all(torch.equal(value, weights[1][key]) for key, value in weights[0].items())
    assert one.store.root == two.store.root
    assert one.fit("mean-image", "cpu") is not None and len(list(tmp_path.iterdir())) == 3


@pytest.mark.thorough
def test_no_process_outlives_a_run_that_is_killed(tmp_path):
    """Else it waits for ever for work that never comes."""
    script = tmp_path / "script.py"
    script.write_text(
        "import os, pathlib, signal, sys\n"
        "from racines_leaderboard.determinism.processes import Processes\n"
        "from racines_leaderboard.determinism.stages import Setup, Stage\n"
        "from tests.leaderboard.determinism.test_determinism import by_process\n"
        "if __name__ == '__main__':\n"
        "    running = Processes(pathlib.Path(sys.argv[1]))\n"
        "    made = running.run(Stage('a', 'b', by_process, ()), Setup(), {})\n"
        "    print(int(made['a']), flush=True)\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([*map(str, sys.path)])}
    words = [sys.executable, str(script), str(tmp_path)]
    done = subprocess.run(words, env=environment, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    assert done.returncode == -signal.SIGKILL
    until(lambda: not psutil.pid_exists(int(done.stdout)))
