"""The walk-throughs, as a new user does them: from an empty folder, by the commands alone.

Each page is run as it stands. Then the files that it left are looked at, whatever the page says.
"""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import ROOT, command
from tests.documents import run_page

pytestmark = [
    pytest.mark.slow,
    pytest.mark.thorough,
    pytest.mark.usefixtures("drawn_pictures"),
]
WALKS = {page.stem for page in (ROOT / "docs").glob("walk-*.md")}


def walk(name: str, folder: Path) -> None:
    assert not list(folder.iterdir())
    assert run_page(ROOT / "docs" / f"walk-{name}.md", folder, command) > 5


def records(folder: Path, track: str) -> dict[str, dict[str, Any]]:
    """Return the records of a track by name, in order."""
    paths = (folder / f"leaderboard/results/first-steps/{track}").glob("*.json")
    return {path.stem: json.loads(path.read_text()) for path in sorted(paths, key=lambda p: p.stem)}


def test_every_walk_is_tested_here():
    assert {f"walk-{name}" for name in ("generator", "agent", "release", "robot")} == WALKS


def test_a_new_generator_gets_the_same_scores_three_times(tmp_path):
    walk("generator", tmp_path)
    made = records(tmp_path, "generators")
    assert {name: record["tier"] for name, record in made.items()} == {
        "ridge": "self-reported",
        "ridge-onnx": "recomputed",
        "ridge-predictions": "recomputed",
    }
    kinds = [record["submission"]["artefacts"][0]["kind"] for record in made.values()]
    assert kinds == ["scores", "generator", "predictions"]
    adapter, onnx, predictions = (record["scores"]["metrics"] for record in made.values())
    for key in ("ssim", "ms_ssim", "psnr", "fid", "kid", "precision", "recall", "nearest_train"):
        assert adapter[key] == onnx[key] == predictions[key], key
        assert adapter[key]["n"] == 16


def test_a_new_agent_gets_the_same_scores_twice(tmp_path):
    walk("agent", tmp_path)
    made = records(tmp_path, "agents")
    assert list(made) == ["copycat", "copycat-trace"]
    policy, trace = (record["scores"] for record in made.values())
    assert {record["tier"] for record in made.values()} == {"recomputed"}
    assert policy["metrics"] == trace["metrics"] and policy["by_seed"] == trace["by_seed"]
    assert policy["metrics"]["success_true"]["n"] == 60


def test_recordings_are_taken_in_and_scanned(tmp_path, monkeypatch):
    monkeypatch.setenv("RACINES", str(ROOT))
    walk("release", tmp_path)
    scores = json.loads((tmp_path / "envs/runs/scores/planner-replay.json").read_text())
    assert scores["task"]["backend"] == "replay"
    (board,) = (tmp_path / "leaderboard/results/my-recordings/generators").glob("*.json")
    assert json.loads(board.read_text())["scores"]["dataset"]["source"] == "release"


def test_a_robot_and_an_organ_get_their_own_board(tmp_path):
    walk("robot", tmp_path)
    results = tmp_path / "leaderboard/results/vessels"
    assert {path.stem for path in results.glob("agents/*.json")} == {"planner-sx", "random-sx"}
    manifest = json.loads((tmp_path / "recordings/manifest.json").read_text())
    assert manifest["source"] == "arm" and manifest["labels"] == ["LX", "SX", "Random"]
