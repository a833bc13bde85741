"""Sweeps over an organ that is no heart, replayed by their labels as docs/replay.md shows."""

import json
import warnings
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from typer.testing import CliRunner

from racines_data.build.dataset import DataConfig, build
from racines_data.sources.phantom import PhantomSource
from racines_data.store.frames import open_store
from racines_envs.task.names import REPLAY_ID
from racines_leaderboard.cli.command import app

VIEW = "KLX"


@pytest.fixture(scope="module")
def abdomen(made_once) -> Path:
    """A dataset of short sweeps over the abdomen."""
    return made_once("abdomen-sweeps", sweeps) / "abdomen"


def sweeps(folder: Path) -> None:
    settings = {"frames": 700, "phantom": {"anatomy": "abdomen"}, "shortest": 40, "longest": 60}
    source = PhantomSource.from_config(settings, [])
    build(source, folder / "abdomen", DataConfig(workers=1, shards=1))


def test_it_is_an_environment_without_the_organ(abdomen: Path):
    store = open_store(abdomen)
    env = gymnasium.make(
        f"racines_envs:{REPLAY_ID}", data=abdomen, view=VIEW, observation="multimodal"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=True)
    seen, info = env.reset(seed=0)
    assert env.unwrapped.core.phantom.unit == "mm"
    for action in (0, 3, 6, 12):
        assert np.array_equal(seen["image"].squeeze(), store.images[info["frame"]])
        assert np.isfinite(seen["params"]).all()
        seen, _, _, _, info = env.step(action)


def test_views_of_the_organ_are_found_by_label(abdomen: Path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    few = "--split", "train", "--starts", "12", "--set", "latency=0", "--json"
    found = {}
    for agent in ("random", "planner"):
        words = ["eval", "agent", agent, "--env", f"replay:{abdomen}", "--view", VIEW, *few]
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, (done.output, done.exception)
        told = json.loads(done.stdout)
        assert told["task"]["view"] == VIEW and told["task"]["backend"] == "replay"
        found[agent] = told["metrics"]["success_true"]["value"]
    assert found["planner"] > 0.9 > 0.5 > found["random"]


def test_a_view_of_another_organ_is_refused(abdomen: Path):
    words = ["eval", "agent", "random", "--env", f"replay:{abdomen}", "--view", "A4C"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code != 0
    assert str(done.exception) == "unknown view 'A4C': choose one of KLX, KSX, GB"
