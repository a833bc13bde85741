"""Engines give the same results in the same order, and say what is wrong with a cluster."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from racines_data.engines import open_engine
from racines_data.engines.local import LocalEngine
from racines_data.engines.ray import RayEngine, _not_started
from racines_data.errors import RacinesError
from tests.data.engines import tasks
from tests.data.engines.conftest import STORE


def test_results_come_in_order_with_the_callers_folder_and_threads(
    engine: RayEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    for threads in (1, 2):
        found = list(engine.map(tasks.told, {"a": 1}, range(20), threads=threads))
        here = list(LocalEngine().map(tasks.told, {"a": 1}, range(20), threads=threads))
        processes = {each.pop("process") for each in found}
        assert {each.pop("process") for each in here} == {os.getpid()}
        assert found == here and os.getpid() not in processes
        assert {each["threads"] for each in found} == {threads}
    assert list(engine.map(tasks.told, None, [])) == []


def test_a_killed_worker_costs_its_task_only(
    engine: RayEngine, tmp_path: Path, capfd: pytest.CaptureFixture[str]
):
    assert list(engine.map(tasks.dies_once, tmp_path, range(8))) == [n * n for n in range(8)]
    assert (tmp_path / "two.died").exists(), "a worker was killed"
    done = {path.name: path.read_text() for path in tmp_path.glob("*.done")}
    assert done == {f"{n}.done": "done\n" for n in range(8)}, "nothing is lost or doubled"
    assert "a worker died: its task runs again" in capfd.readouterr().err


def test_a_task_that_kills_every_worker_ends(engine: RayEngine, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("racines_data.engines.ray.TRIES", 2)
    with pytest.raises(RacinesError, match="begun 2 times and its worker died.*--workers"):
        list(engine.map(tasks.dies_always, None, [0]))


def test_a_refusal_is_told_as_it_is_here(engine: RayEngine):
    made = engine.map(tasks.refuses, "file.csv", range(6))
    assert [next(made) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(RacinesError, match="^file.csv: three is refused$"):
        next(made)


def test_a_worker_of_another_version_is_refused(engine: RayEngine, monkeypatch: pytest.MonkeyPatch):
    from racines_data.engines import ray, versions

    here = versions.versions()
    monkeypatch.setattr(ray, "versions", lambda: here | {"racines": "9.9.9", "torch": "1.0"})
    told = f"has racines {here['racines']}, torch {here['torch']}; the machine.*"
    told += "racines 9.9.9, torch 1.0: install the same.*pip install racines==9.9.9 torch==1.0"
    with pytest.raises(RacinesError, match=told):
        list(engine.map(tasks.told, None, range(2)))


def test_what_an_object_store_does_not_hold_is_refused(engine: RayEngine):
    with pytest.raises(RacinesError, match="takes 10[0-9] MB.*--object-store-memory.*/dev/shm"):
        list(engine.map(tasks.told, np.zeros(STORE + (1 << 20), np.uint8), [0]))


def test_what_ray_says_of_its_memory_is_told_with_a_remedy():
    told = _not_started("local", ValueError("Attempting to cap object store memory usage at 1"))
    assert "too little memory" in str(told) and "/dev/shm" in str(told)
    told = _not_started("a:1", RuntimeError("Version mismatch: The cluster was started with 2.50"))
    assert "started with 2.50" in str(told) and "install the versions" in str(told)


@pytest.mark.parametrize(
    ("address", "told"),
    [
        ("127.0.0.1:1", "no Ray answers there: start one with `ray start --head`"),
        ("nowhere", "no Ray answers there"),
        ("ray://head:10001", "ray job submit"),
    ],
)
def test_an_address_without_ray_is_refused_at_once(address: str, told: str):
    with pytest.raises(RacinesError, match=told):
        open_engine("ray", address)


def test_an_address_needs_an_engine_that_takes_one():
    with pytest.raises(RacinesError, match="--address head:6379: give --engine ray"):
        open_engine("local", "head:6379")


def test_an_unknown_engine_is_refused():
    with pytest.raises(RacinesError, match="unknown engine 'dask': choose one of local, ray"):
        open_engine("dask")


def test_without_ray_the_command_says_what_to_install(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(RacinesError, match=r"pip install \"racines\[ray\]\""):
        open_engine("ray")
