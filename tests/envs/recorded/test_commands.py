"""`racines train agent` and `racines eval agent` with --env replay:FOLDER."""

import json

import pytest
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_envs.worlds.recorded.settings import read_env
from racines_leaderboard.cli.command import app
from tests.envs.recorded.held import HeldFrames, line

SCORES = "envs/runs/scores"


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch, tiny_root):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").symlink_to(tiny_root)


def run(*words: str, code: int = 0):
    done = CliRunner().invoke(app, list(words), catch_exceptions=True)
    assert done.exit_code == code, (done.output, done.exception)
    return done


def test_floors_and_bounds_are_scored_from_starts_of_the_test_split(tmp_path):
    few = ["--env", "replay:mine", "--view", "SC", "--starts", "8", "--set", "latency=0"]
    for agent in ("random", "planner"):
        run("eval", "agent", agent, *few, "--set", "max_steps=80")
    found = {
        agent: json.loads((tmp_path / SCORES / f"{agent}-replay-mine-sc-test.json").read_text())
        for agent in ("random", "planner")
    }
    success = {agent: each["metrics"]["success_true"] for agent, each in found.items()}
    assert success["planner"]["value"] > success["random"]["value"] + 0.4
    told = found["random"]
    assert told["phantom"]["settings"]["split"] == "test"
    assert told["phantom"]["settings"]["max_steps"] == 80
    assert told["task"]["backend"] == "replay" and told["task"]["definition"]["view"] == "SC"
    assert success["random"]["settings"]["units"] < 24  # trajectories, not starts
    assert told["metrics"]["position_error"]["unit"] == "mm"
    assert (tmp_path / SCORES / "random-replay-mine-sc-test.png").stat().st_size > 5000


@pytest.mark.parametrize("beyond", ["refuse", "mask"])
def test_a_policy_is_trained_and_scored(tmp_path, beyond):
    settings = ["--env", "replay:mine", "--view", "SC", "--set", f"beyond={beyond}"]
    small = ["--set", "envs=16", "--set", "update_every=256", "--set", "validate_every=512"]
    small += ["--set", "validation_starts=4", "--set", "max_steps=30", "--set", "minibatch=128"]
    run("train", "agent", "ppo", *settings, *small, "--frames", "512")
    folder = tmp_path / "envs/runs/ppo-replay-mine-sc"
    told = json.loads((folder / "metrics.json").read_text())
    assert told["phantom"]["settings"]["split"] == "train"
    assert told["phantom"]["settings"]["beyond"] == beyond
    few = ["--starts", "4", "--set", "latency=0", "--set", "max_steps=30", "--json"]
    done = run("eval", "agent", "ppo", *settings, *few)
    scores = json.loads(done.stdout)
    assert scores["weights"]["files"] and scores["phantom"]["settings"]["beyond"] == beyond
    if beyond == "mask":
        assert scores["metrics"]["violations"]["value"] == 0.0


def test_a_goal_frame_is_looked_for_and_lengths_are_in_the_units_of_the_dataset(monkeypatch):
    held = HeldFrames(line() * 1e3, scale="unknown", splits=(30, 36))
    monkeypatch.setattr("racines_envs.worlds.recorded.opening.open_store", lambda data: held)
    words = ["--env", "replay:mine", "--goal", "sweep-0:20", "--starts", "4"]
    done = run("eval", "agent", "planner", *words, "--set", "latency=0", "--json")
    scores = json.loads(done.stdout)
    assert scores["task"]["view"] == "Goal" and scores["phantom"]["unit"] == "px"
    units = {each.get("unit") for each in scores["metrics"].values()}
    assert "px" in units and "mm" not in units
    assert {each.get("unit") for each in scores["by_seed"]["0"].values()} & {"px", "mm"} == {"px"}


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (["--env", "mine", "--view", "SC"], "env 'mine': write replay:FOLDER"),
        (["--env", "replay:", "--view", "SC"], "env 'replay:': write replay:FOLDER"),
        (["--env", "replay:gone", "--view", "SC"], "gone: no dataset here"),
        (["--goal", "a:1"], "--goal needs --env replay:FOLDER"),
        (["--env", "replay:mine", "--goal", "a:1"], "no frame 'a:1'"),
        (["--env", "replay:mine", "--view", "SC", "--split", "all"], "unknown split 'all'"),
        (["--env", "replay:mine", "--view", "SC", "--set", "far=1"], "evaluation.far: unknown key"),
        (["--env", "replay:mine", "--view", "SC", "--backend", "phantom"], "has frames of its own"),
    ],
)
def test_wrong_words_are_refused(words, match):
    done = run("eval", "agent", "random", *words, code=1)
    assert match in str(done.exception) + done.output


def test_an_env_is_a_folder_after_the_word_replay():
    assert str(read_env("replay:my/set")) == "my/set"
    with pytest.raises(RacinesError, match="write replay:FOLDER"):
        read_env("phantom:x")
