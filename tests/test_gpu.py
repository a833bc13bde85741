"""`make gpu` at its smallest size on a CPU: parts, their order, what stops and what goes on."""

import importlib
import json
import subprocess
import sys
import time
from importlib import metadata
from pathlib import Path

import pytest
import torch

from racines_models.training.curves import Curves
from tests.benchmarks.gpu import document, patients, training
from tests.benchmarks.gpu.sizes import TINY
from tests.conftest import ROOT

gpu = importlib.import_module("tests.benchmarks.gpu.__main__")
MEASURED = ("correctness", "render", "images", "params", "ppo")


def run(folder: Path, *words: str, budget: str = "1h") -> int:
    given = ["--device", "cpu", "--tiny", "--budget", budget, "--out", str(folder / "gpu.json")]
    return gpu.main([*given, "--work", str(folder / "work"), *words])


def kept(folder: Path) -> dict:
    return document.read(folder / "gpu.json")


@pytest.mark.thorough
def test_what_is_measured_is_kept_and_not_measured_again(tmp_path: Path, monkeypatch):
    assert run(tmp_path, "--parts", ",".join(MEASURED)) == 0
    content = kept(tmp_path)
    assert list(content["parts"]) == list(MEASURED)
    for part in content["parts"].values():
        assert part["state"] == "done" and part["figures"]
    found = content["parts"]["correctness"]["figures"]
    assert found["levels"] == 0 and found["reward"] == 0.0  # the CPU against itself
    assert found["episodes"]["oracle"]["rows_apart"] == found["truth"]["views_apart"] == 0
    assert content["parts"]["params"]["figures"]["by_batch"].keys() == {"2", "4"}
    rows = {row[0]: row[1] for row in content["tables"]["gpu"]["rows"]}
    assert rows["the phantom's pixels more than a gray level apart"] == "0.0000 %"
    assert rows["success of the paper's agent, SC"] == "not measured"
    before = (tmp_path / "gpu.json").read_text()

    def again(*_: object) -> None:
        raise AssertionError("measured again")

    monkeypatch.setattr(gpu, "parts", lambda *_: {name: (again, 1.0) for name in MEASURED})
    assert run(tmp_path) == 0 and (tmp_path / "gpu.json").read_text() == before


def test_parts_stop_in_time_go_on_and_do_not_hinder_others(tmp_path: Path, monkeypatch):
    given: list[tuple[str, float]] = []

    def part(name: str, done: bool):
        def work(left: float):
            given.append((name, left))
            if name == "images":
                raise ValueError("too little memory")
            return done, {"frames": len(given)}

        return work

    order = {"render": True, "images": True, "agent-SC": False, "generator-cgan": True}
    shares = {"render": 1.0, "images": 1.0, "agent-SC": 0.5, "generator-cgan": 1.0}
    found = {name: (part(name, done), shares[name]) for name, done in order.items()}
    monkeypatch.setattr(gpu, "parts", lambda *_: found)
    assert run(tmp_path, budget="115s") == 1
    states = {name: each["state"] for name, each in kept(tmp_path)["parts"].items()}
    assert states == {
        "render": "done", "images": "failed", "agent-SC": "under way", "generator-cgan": "done",
    }  # fmt: skip
    assert kept(tmp_path)["parts"]["images"]["figures"] == {"error": "too little memory"}
    left = dict(given)
    assert 90 < left["render"] <= 100 and 45 < left["agent-SC"] <= 50
    given.clear()
    assert run(tmp_path, budget="10s") == 0 and not given  # no time for anything
    assert run(tmp_path, "--parts", "agent-SC", budget="1m") == 0
    assert [name for name, _ in given] == ["agent-SC"]


def test_a_training_under_way_tells_how_far_it_is(tmp_path: Path, monkeypatch):
    def stopped(words: list[str], log: Path, seconds: float) -> bool:
        with Curves(Path(words[words.index("--out") + 1])) as curves:
            for frames, success in ((250_000, 0.1), (500_000, 0.2), (1_000_000, 0.4)):
                curves.row(
                    frames, {"validation/success": success, "validation/return": frames / 1e4}
                )
                curves.row(frames, {"validation/steps": 150.0, "frames_per_second": 5_000.0})
        return False

    monkeypatch.setattr(training, "run", stopped)
    done, figures = training.agent("SC", "cpu", TINY, tmp_path, 1.0)
    assert not done and figures["frames"] == 1_000_000 and figures["success"] == 0.4
    assert [row["validation/success"] for row in figures["history"]] == [0.1, 0.2, 0.4]
    told = document.curve({"agent-SC": {"figures": figures}})["rows"]
    assert told == [["250,000", "25", "10 %", "150"], ["1,000,000", "100", "40 %", "150"]]


def test_a_grid_is_judged_once_all_its_trainings_are_there(tmp_path: Path, monkeypatch):
    asked: list[str] = []

    def stopped(words: list[str], log: Path, seconds: float) -> bool:
        asked.append(words[0])
        if words[0] == "train":  # the first of three trainings is done, and time is over
            log.mkdir(parents=True, exist_ok=True)
            (log / "metrics.json").write_text("{}")
            return len(asked) > 1
        metric = {"success_declared": {"value": 0.5, "low": 0.4, "high": 0.6}}
        log.with_suffix(".json").write_text(json.dumps({"runs": 3, "metrics": metric}))
        return True

    monkeypatch.setattr(patients, "run", stopped)
    assert patients.grid("servo-full", "cpu", TINY, tmp_path, 60.0) == (False, {})
    assert asked == ["train"]
    done, figures = patients.grid("servo-full", "cpu", TINY, tmp_path, 60.0)
    assert done and figures["trainings"] == 3 and figures["mean"] == 0.5
    assert asked == ["train", "train", "eval", "eval"]
    patients.grid("servo-full", "cpu", TINY, tmp_path, 60.0)
    assert len(asked) == 4, "neither trained nor judged again"


def test_another_machines_file_is_refused_and_so_is_no_device(tmp_path: Path, capsys):
    here = document.machine("cpu")
    content = document.whole({**here, "device": "Another GPU"}, {}, tiny=True)
    (tmp_path / "gpu.json").write_text(json.dumps(content))
    assert run(tmp_path) == 1
    assert "holds figures of Another GPU" in capsys.readouterr().err
    (tmp_path / "gpu.json").write_text("{}")
    assert run(tmp_path) == 1 and "no figures of a GPU" in capsys.readouterr().err
    if not torch.cuda.is_available():
        out = ["--out", str(tmp_path / "none.json")]
        assert gpu.main(out) == 1 and not (tmp_path / "none.json").exists()
        told = capsys.readouterr().err.splitlines()
        assert len(told) == 1 and "device 'cuda': there is none here" in told[0]
    assert run(tmp_path / "other", "--parts", "render,speed") == 1
    assert "unknown part 'speed': choose of correctness, render" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        run(tmp_path, budget="soon")
    assert ended.value.code == 2


def test_a_checkout_that_is_not_installed_knows_its_plugins(monkeypatch):
    def absent(_: str) -> str:
        raise metadata.PackageNotFoundError

    monkeypatch.setattr(gpu, "version", absent)
    monkeypatch.setattr(sys, "path", [*sys.path])
    gpu._registered()
    [told] = metadata.distributions(name="racines", path=[sys.path[0]])
    own = {point.name for point in told.entry_points if point.group == "racines.agents"}
    assert {"ppo", "planner"} <= own and told.version


def test_the_page_says_what_was_measured():
    content = document.read(ROOT / "docs/results/gpu.json")
    assert content == document.whole(content["hardware"], content["parts"])


def test_make_hands_on_budget_device_and_parts():
    words = ["make", "-n", "gpu", "BUDGET=5m", "DEVICE=cuda:1", "OUT=x.json", "PARTS=render,ppo"]
    said = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for word in ("--budget 5m", "--device cuda:1", "--out x.json", "--parts render,ppo"):
        assert word in said.replace("\\\n", " ")


@pytest.mark.thorough
def test_a_command_that_fails_or_takes_too_long_says_so(tmp_path: Path):
    with pytest.raises(training.RacinesError, match=r"racines train agent no-such: exit 1: .*"):
        training.run(["train", "agent", "no-such"], tmp_path / "failed", 60)
    began = time.monotonic()
    words = ["train", "agent", "ppo", "--out", str(tmp_path / "slow"), "--frames", "100000000"]
    assert training.run(words, tmp_path / "slow", 3) is False
    assert time.monotonic() - began < 3 + training.PATIENCE


@pytest.mark.thorough
def test_the_whole_order_of_parts_and_a_training_that_goes_on(tmp_path: Path):
    assert run(tmp_path) == 0
    parts = kept(tmp_path)["parts"]
    grid = "grid-constant-pose"
    assert list(parts) == [*MEASURED, "agent-SC", "data", "generator-vae-gan", grid]
    assert set(parts[grid]["figures"]["found"]) == {"A4C-patients", "A4C-beating"}
    assert {part["state"] for part in parts.values()} == {"done"}
    assert parts["agent-SC"]["figures"]["frames"] == 8
    assert len(parts["agent-SC"]["figures"]["history"]) == 2
    assert parts["generator-vae-gan"]["figures"]["images"] == 320
