"""The determinism report: what differs is seen, what does not is not."""

import json

import pytest
import torch

from racines_data.errors import RacinesError
from racines_leaderboard.cli.audit import determinism
from racines_leaderboard.determinism import run as module
from racines_leaderboard.determinism.run import (
    cell,
    compare_stage,
    determinism_markdown,
    differences,
    measure,
)
from racines_leaderboard.determinism.stages import Setup, Stage, Work, in_batches, threads


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
    twice, more, single = compare_stage(stage, Work(tmp_path))
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


def test_a_real_stage_repeats_itself(tmp_path, capsys):
    determinism(["mean-image, drawing"], tmp_path / "report.json", as_json=False)
    document = json.loads((tmp_path / "report.json").read_text())
    told = {each["compared"]: each["bitwise"] for each in document["outcomes"]}
    assert told["twice"] and told["1 and 2 threads"] and told["batch 64 and 1"]
    assert "| mean-image, drawing | bitwise | bitwise | bitwise |" in capsys.readouterr().out


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
