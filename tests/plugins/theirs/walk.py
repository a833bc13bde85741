"""Follows each plug-in to where a user meets it, and prints what was seen as JSON."""

import json
import os
from pathlib import Path

import datasets
import gymnasium
import torch
from typer.testing import CliRunner

import racines_envs
from racines_data.phantom import PhantomConfig
from racines_data.phantom.config import BlockConfig
from racines_envs.agents import load_agent
from racines_envs.agents.rollout import rollout
from racines_leaderboard.cli.command import app
from racines_models.judges.grader.model import Grader, GraderConfig, GraderNetwork

SEEN: dict = {}


def racines(*words: str) -> str:
    done = CliRunner().invoke(app, list(words), env={"COLUMNS": "500"})
    assert done.exit_code == 0, (words, done.output, done.exception)
    return done.output


def data() -> None:
    made = json.loads(racines("data", "build", "--source", "mine", "--out", "racines", "--json"))
    SEEN["built"] = [made["source"], made["version"], made["counts"]["frames"]]
    SEEN["valid"] = json.loads(racines("data", "validate", "racines", "--json"))["ok"]
    frames = datasets.load_dataset("racines", split="train")
    SEEN["loaded"] = frames.features["source"].int2str(frames[0]["source"])
    racines("data", "export", "racines", "--format", "names", "--out", "names")
    SEEN["exported"] = Path("names").is_dir()


def environments() -> None:
    ours = {"backend": "replay", "data": "racines", "observation": "params", "reward": "mine"}
    env = gymnasium.make("racines/SC-v0", **ours)
    core = env.unwrapped.core
    env.reset(seed=0)
    before = float(core._distance()[0])
    paid = env.step(0)[1]
    SEEN["reward"] = [core.reward.name, abs(paid - 1 - before + float(core._distance()[0])) < 1e-4]
    steps = rollout(core, load_agent("still", "."), torch.tensor([3])).final["steps"]
    SEEN["agent"] = int(steps[0])
    phantom = PhantomConfig(anatomy="cyst", block=BlockConfig(voxel=0.004))
    organ = gymnasium.make(
        "racines/cyst-CY-v0", phantom=phantom, observation="params", reward="oracle"
    )
    organ.reset(seed=0)
    SEEN["organ"] = [organ.unwrapped.core.task.anatomy, organ.unwrapped.core.task.view]


def board() -> None:
    where = ("--data", "racines", "--device", "cpu")
    for name in ("mean-image", "flat"):
        racines("train", "generator", name, *where)
    racines("eval", "generator", "flat", *where, "--no-grader", "--no-pose")
    scores = json.loads(Path("models/runs/scores/flat.json").read_text(encoding="utf-8"))
    SEEN["scores"] = {name: scores["metrics"][name] for name in ("offset", "shift")}
    SEEN["board"] = racines("leaderboard", "--board", "theirs", "--collect", "models/runs/scores")


def rest() -> None:
    SEEN["command"] = racines("greet", "you", "--loud")
    SEEN["help"] = racines("--help")
    Grader(GraderNetwork(32, 0.125), GraderConfig(input_size=32, width=0.125)).save(Path("judge"))
    about = json.loads(Path("judge/config.json").read_text(encoding="utf-8")) | {
        "architecture": "tiny"
    }
    Path("judge/config.json").write_text(json.dumps(about), encoding="utf-8")
    SEEN["judge"] = type(Grader.load("judge")).__name__


if __name__ == "__main__":
    assert racines_envs
    data(), environments(), board(), rest()
    Path(os.environ["SEEN"]).write_text(json.dumps(SEEN), encoding="utf-8")
