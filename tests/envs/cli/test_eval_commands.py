"""`racines study transfer`, `rewards` and `curves`, on the real phantom at a tiny size."""

import json

import pytest
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_leaderboard.cli.command import app


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_the_reward_report_is_written(real_phantom, tmp_path):
    words = ["study", "rewards", "planner,lost=random", "--rewards", "oracle", "--starts", "2"]
    done = CliRunner().invoke(app, [*words, "--out", "r/x.json"], catch_exceptions=False)
    assert done.exit_code == 0 and "| lost | oracle | k_hits |" in done.stdout
    content = json.loads((tmp_path / "r/x.json").read_text())
    assert content["schema"] == "racines.agent-rewards/1" and len(content["rows"]) == 6
    assert (tmp_path / "r/x.md").read_text() in done.stdout
    assert (tmp_path / "r/x.png").stat().st_size > 5000


def test_the_transfer_matrix_is_written(real_phantom, tmp_path):
    words = [
        "study",
        "transfer",
        "--agents",
        "planner",
        "--agents",
        "random",
        "--backends",
        "phantom",
    ]
    words += ["--starts", "2", "--seeds", "0,3", "--json"]
    done = CliRunner().invoke(app, words, catch_exceptions=False)
    content = json.loads(done.stdout)
    assert content["start_set"] == {"seeds": [0, 3], "starts": 2}
    assert [cell["agent"] for cell in content["cells"]] == ["planner", "random"]
    out = tmp_path / "envs/runs/scores"
    assert json.loads((out / "transfer.json").read_text()) == content
    assert (out / "transfer.md").is_file() and (out / "transfer.png").is_file()


def test_curves_are_drawn(tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    history = [{"frames": frames, "validation/steps": 9.0} for frames in (10, 20)]
    (run / "metrics.json").write_text(json.dumps({"history": history}))
    done = CliRunner().invoke(app, ["study", "curves", "run"], catch_exceptions=False)
    assert "written" in done.stdout and (tmp_path / "envs/runs/scores/curves.png").is_file()


def test_bad_words_are_refused():
    runner = CliRunner()
    backends = ["--backends", "phantom"]
    wrong = runner.invoke(
        app, ["study", "transfer", "--agents", "random", *backends, "--seeds", "a"]
    )
    assert wrong.exit_code == 2
    ghost = runner.invoke(
        app, ["study", "transfer", "--agents", "ghost", *backends, "--starts", "1"]
    )
    assert isinstance(ghost.exception, RacinesError) and "unknown agent" in str(ghost.exception)
