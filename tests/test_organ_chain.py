"""Every command on another organ than the heart, at the smallest size."""

import copy
import json

import pytest
import yaml

from racines_data.config import read_params
from tests.conftest import TINY, command

AGENTS = ("planner", "ppo")


@pytest.mark.thorough
def test_the_whole_chain_runs_on_the_abdomen(tmp_path):
    params = copy.deepcopy(TINY)
    params["data"]["phantom"]["phantom"] = {"anatomy": "abdomen"}
    params["agents"]["ppo"]["view"] = params["evaluation"]["view"] = "KSX"
    params["evaluation"]["grader"] = "models/runs/grader"
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(params))
    command(tmp_path, "racines", "data", "build", "--out", "data/racines")
    command(tmp_path, "racines", "train", "grader")
    command(tmp_path, "racines", "train", "generator", "mean-image")
    command(tmp_path, "racines", "eval", "generator", "mean-image", "--samples", "8")
    command(tmp_path, "racines", "train", "agent", "ppo")
    for agent in AGENTS:
        command(tmp_path, "racines", "eval", "agent", agent)
    command(tmp_path, "racines", "study", "realism", "--optional")
    command(
        tmp_path, "racines", "leaderboard", "--board", "tiny", "--collect", "models/runs/scores",
        "--collect", "envs/runs/scores", "--markdown", "LEADERBOARD.md",
    )  # fmt: skip
    grader = json.loads((tmp_path / "models/runs/grader/metrics.json").read_text())
    assert grader["confusion"]["labels"] == ["KLX", "KSX", "GB", "Random"]
    planner = json.loads((tmp_path / "envs/runs/scores/planner.json").read_text())
    assert planner["task"]["view"] == "KSX"
    assert planner["task"]["definition"]["anatomy"] == "abdomen"
    assert planner["metrics"]["success_true"]["value"] == 1.0
    page = (tmp_path / "LEADERBOARD.md").read_text()
    assert all(name in page for name in ("mean-image", *AGENTS))


def test_the_packaged_profile_names_the_organ_and_its_views():
    params = read_params(profile="abdomen")
    assert params["data"]["phantom"]["phantom"] == {"anatomy": "abdomen"}
    assert params["evaluation"]["view"] == params["agents"]["ppo"]["view"] == "KLX"
    assert not params["realism"]  # there are no real frames of it
