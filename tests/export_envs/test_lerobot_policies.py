"""A policy of the real LeRobot, there and back: `make test-exports`.

ACT trains on our export without edits, is evaluated in our tasks by `lerobot-eval`, and comes back
as an ONNX policy that acts as LeRobot's own `select_action` does.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import torch

from racines_data.export.registry import load_exporter
from racines_envs.agents.onnx.policy import OnnxPolicyAgent
from racines_envs.apis.lerobot import write_envhub
from racines_envs.worlds.making import make_core
from tests.export_envs.running import HERE, run_in

pytestmark = pytest.mark.timeout(900)


class Trained(NamedTuple):
    folder: Path
    checkpoint: Path
    variables: dict[str, str]


@pytest.fixture(scope="module")
def trained(tiny_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Trained]:
    folder = tmp_path_factory.mktemp("act")
    made = load_exporter("lerobot-task")(tiny_root, folder / "export")
    assert made["format"] == "lerobot-task"
    write_envhub(folder / "hub", ["SC"], "lerobot-task")
    aims = json.loads((folder / "export/meta/racines.json").read_text())["episodes"]
    home = str(folder / "home")
    variables = {"HF_HOME": home, "HF_LEROBOT_HOME": home, "PYTHONPATH": str(folder / "hub")}
    policy = "type=act device=cpu push_to_hub=false pretrained_backbone_weights=null chunk_size=5 "
    policy += "n_action_steps=1 dim_model=32 dim_feedforward=64 n_encoder_layers=1 use_vae=false"
    words = [f"--policy.{word}" for word in policy.split()]
    words += [f"--dataset.root={folder / 'export'}", "--dataset.repo_id=racines/export"]
    words += [f"--dataset.episodes={aims['train']['SC']}", f"--output_dir={folder / 'run'}"]
    words += ["--batch_size=4", "--steps=3", "--num_workers=0", "--wandb.enable=false"]
    run_in("lerobot", "-m", "lerobot.scripts.lerobot_train", *words, **variables)
    yield Trained(folder, folder / "run/checkpoints/last/pretrained_model", variables)


def test_act_trains_on_the_export_without_edits(trained: Trained):
    told = json.loads((trained.checkpoint / "config.json").read_text())
    seen = {name: feature["shape"] for name, feature in told["input_features"].items()}
    wanted = {"observation.images.ultrasound": [3, 128, 128], "observation.state": [9]}
    assert seen == wanted and told["output_features"]["action"]["shape"] == [6]


def test_lerobot_evaluates_it_in_the_folders_tasks(trained: Trained):
    words = "--env.discover_packages_path=lerobot_env_racines --env.type=racines "
    words += "--policy.device=cpu --eval.n_episodes=2 --eval.batch_size=2 --seed=3"
    out = trained.folder / "evaluated"
    where = [f"--policy.path={trained.checkpoint}", f"--output_dir={out}"]
    run_in("lerobot", "-m", "lerobot.scripts.lerobot_eval", *words.split(), *where,
           **trained.variables)  # fmt: skip
    told = json.loads((out / "eval_info.json").read_text())
    assert told["overall"]["n_episodes"] == 2
    (metrics,) = [each["metrics"] for each in told["per_task"]]
    assert len(metrics["successes"]) == 2 and np.isfinite(metrics["sum_rewards"]).all()


def test_it_comes_back_as_a_policy_that_acts_alike(trained: Trained):
    path = trained.folder / "act.onnx"
    script = str(trained.folder / "hub" / "to_onnx.py")
    run_in("lerobot", script, str(trained.checkpoint), str(path), "--view", "SC",
           **(trained.variables | {"PYTHONPATH": ""}))  # fmt: skip
    agent = OnnxPolicyAgent(path)
    assert agent.action == "velocity" and agent.view == "SC"
    core = make_core("SC", 6, observation="multimodal", action="velocity")
    seen = core.reset(5)
    np.savez(trained.folder / "seen.npz", **{name: seen[name].numpy() for name in seen})
    out = trained.folder / "actions.npy"
    where = [str(trained.checkpoint), str(trained.folder / "seen.npz"), str(out)]
    run_in("lerobot", str(HERE / "lerobot_acting.py"), *where, **trained.variables)
    theirs = np.load(out)
    assert theirs.std(0).max() > 1e-5  # the actions depend on what is seen
    assert np.allclose(agent.logits(seen).numpy(), theirs, rtol=1e-4, atol=1e-5)
    taken = agent.act(seen, torch.zeros(6, dtype=torch.int64))
    core.step(taken)
