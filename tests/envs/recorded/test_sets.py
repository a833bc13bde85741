"""A probe that turns at a beating heart, and a tracked sweep: replayed as they are imported.

Both are made and scored by the commands that docs/replay.md shows.
"""

import json
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from typer.testing import CliRunner

from racines_data.geometry import Pose, parameters_to_pose, pose_keys
from racines_data.store.frames import open_store
from racines_envs.task.names import REPLAY_ID
from racines_leaderboard.cli.command import app
from tests.data.sources.rotation_folder import PHASES, write_rotation
from tests.data.sources.test_tracked import write_sequence


class Recorded(NamedTuple):
    """A dataset, and how it is replayed."""

    root: Path
    settings: dict[str, Any]
    """Of the replay, by name."""
    unit: str


def run(*words: str) -> str:
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == 0, (done.output, done.exception)
    return done.stdout


@pytest.fixture(scope="module", params=["rotation", "tracked"])
def recorded(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    base = tmp_path_factory.mktemp(request.param)
    out = base / request.param
    if request.param == "rotation":
        folder = write_rotation(base / "heart")
        run("data", "import", str(folder), "--source", "rotation", "--out", str(out))
        return Recorded(out, {"goal": "turn-0012:0", "reach": 20.0}, "px")
    sweep = write_sequence(base / "sweep.igs.mha")
    words = "--source", "tracked", "--set", "segments=5", "--out", str(out)
    run("data", "import", str(sweep), *words)
    return Recorded(out, {"goal": "sweep-02:1", "within": 3.0}, "mm")


def test_it_is_an_environment(recorded: Recorded):
    store = open_store(recorded.root)
    env = gymnasium.make(
        f"racines_envs:{REPLAY_ID}", data=recorded.root, observation="multimodal",
        split="train", **recorded.settings,
    )  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=True)
    core = env.unwrapped.core
    assert core.phantom.unit == recorded.unit
    seen, info = env.reset(seed=0)
    # In one of the sets the probe only turns, in the other it only moves: nothing weighs the two.
    train = store.split_indices("train")
    keys = pose_keys(parameters_to_pose(store.parameters.double()), 1.0)
    shown = set()
    for turn in range(48):
        assert np.array_equal(seen["image"].squeeze(), store.images[info["frame"]])
        here = Pose(core.state.position.double(), core.state.rotation.double())
        unit = 1e3 if recorded.unit == "px" else 1.0
        own = pose_keys(Pose(here.position * unit, here.rotation), 1.0)
        away = (keys - own).norm(dim=1)
        assert float(away[info["frame"]]) < float(away[train].min()) + 1e-4, "the nearest in pose"
        shown.add(info["frame"])
        seen, _, ended, cut, info = env.step(turn // 4)  # each step four times
        if ended or cut:
            seen, info = env.reset()
    assert len(shown) > 1
    assert "wrench" not in seen  # nobody measured it


def test_while_the_probe_rests_a_heart_goes_on_and_all_else_stands(recorded: Recorded):
    store = open_store(recorded.root)
    env = gymnasium.make(f"racines_envs:{REPLAY_ID}", data=recorded.root, **recorded.settings)
    _, info = env.reset(seed=0)
    frames = [info["frame"]]
    for _ in range(10):
        frames.append(env.step(12)[-1]["frame"])
    shown = store.trajectory_index[frames]
    assert len(shown.unique()) == 1 and len(set(frames)) == (1 if store.phases is None else PHASES)


def test_agents_are_scored_by_the_command(recorded: Recorded, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    more = dict(recorded.settings)
    words = ["--env", f"replay:{recorded.root}", "--goal", more.pop("goal")]
    words += [each for key, value in more.items() for each in ("--set", f"{key}={value}")]
    few = "--split", "train", "--starts", "6", "--set", "latency=0", "--set", "max_steps=60"
    found = {}
    for agent in ("random", "planner"):
        told = json.loads(run("eval", "agent", agent, *words, *few, "--json"))
        found[agent] = told["metrics"]["success_true"]["value"]
        assert told["phantom"]["unit"] == recorded.unit and told["task"]["backend"] == "replay"
        units = {each.get("unit") for each in told["metrics"].values()}
        assert recorded.unit in units and len(units & {"px", "mm"}) == 1
    assert found["planner"] == 1.0 and found["random"] < 0.9
