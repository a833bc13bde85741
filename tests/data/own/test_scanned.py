"""An agent scans a heart of one's own, by the commands that docs/own-anatomy.md shows."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from racines_leaderboard.cli.command import app


@pytest.fixture(autouse=True)
def place(small_heart: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stand where a folder `heart` lies, which is also the name of the built-in anatomy."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "heart").symlink_to(small_heart)


def scanned(*words: str, code: int = 0):
    few = "--split", "validation", "--patients", "2", "--starts", "2"
    named = "eval", "agent", "planner", *words, *few, "--set", "phantom=heart", "--json"
    done = CliRunner().invoke(app, named)
    assert done.exit_code == code, (done.output, done.exception)
    return done


@pytest.mark.parametrize("tier", ["patients", "beating"])
def test_the_planner_finds_its_view(tier: str, small_heart: Path):
    scores = json.loads(scanned("--view", "A4C", "--tier", tier).stdout)
    digest = json.loads((small_heart / "phantom.json").read_text())["digest"]
    assert digest in json.dumps(scores["phantom"])  # not the patients' own hearts
    found = scores["metrics"]["success_declared"]
    assert found["value"] == 1.0 and found["n"] == 4
    assert found["settings"]["units"] == 2  # patients
    assert scores["metrics"]["episode_steps"]["value"] > 3.0  # starts do not show the view


def test_a_view_that_it_lacks_is_refused(tmp_path: Path):
    done = scanned("--view", "SC", "--tier", "patients", code=1)
    assert "SC" in str(done.exception) and "A4C" in str(done.exception)
    assert not list(tmp_path.rglob("*.json"))
