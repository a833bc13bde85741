"""The records beside the one that is audited."""

import json
import shutil
from pathlib import Path

import pytest

from racines_leaderboard.audit import bench as benches
from racines_leaderboard.audit.bench import Bench, Places
from tests.conftest import ROOT

BOARD = "phantom-default"


def test_each_is_read_once_and_anew_when_its_file_is_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    results = tmp_path / "results"
    shutil.copytree(ROOT / "leaderboard/results" / BOARD, results / BOARD)
    paths = sorted((results / BOARD / "agents").glob("*.json"))
    read: list[Path] = []

    def reading(path: Path, *of: object) -> object:
        read.append(path)
        return true(path, *of)

    true = benches.read_record
    monkeypatch.setattr(benches, "read_record", reading)
    bench = Bench(BOARD, Places(results=results))
    for _ in range(2):
        for path in paths:
            names = [record["name"] for record in bench.peers(path)]
            assert names == [other.stem for other in paths if other != path]
    assert sorted(read) == paths
    content = json.loads(paths[0].read_text())
    paths[0].write_text(json.dumps(content | {"tier": "reproduced"}))
    assert bench.peers(paths[1])[0]["tier"] == "reproduced"
    paths[0].write_text("{")
    assert [record["name"] for record in bench.peers(paths[1])] == [p.stem for p in paths[2:]]
    assert read[len(paths) :] == [paths[0]] * 2


def test_a_judge_is_hashed_once_and_anew_when_its_file_is_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    weights = tmp_path / "grader.safetensors"
    weights.write_bytes(b"one")
    hashed: list[Path] = []

    def hashing(path: Path) -> str:
        hashed.append(path)
        return true(path)

    true = benches.sha256_file
    monkeypatch.setattr(benches, "sha256_file", hashing)
    bench, first = Bench(BOARD, Places(judges={"grader": tmp_path})), true(weights)
    assert [bench.judge("grader", first) for _ in range(3)] == [tmp_path] * 3
    assert hashed == [weights]
    weights.write_bytes(b"another")
    assert bench.judge("grader", first) is None
    assert bench.judge("grader", true(weights)) == tmp_path and hashed == [weights] * 2
