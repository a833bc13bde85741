"""Several trainings of one agent: trained, resumed, found, scored; and what cannot pass for one."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import yaml
from safetensors.torch import load_file, save_file
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_envs.agents import learns
from racines_envs.agents.onnx.policy import OnnxPolicyAgent, export_run
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.ppo import PPOAgent, PPOConfig
from racines_envs.agents.random import RandomAgent
from racines_envs.agents.training import TrainingRun
from racines_envs.evaluation.agent_specs import find_entry
from racines_envs.evaluation.run import EvaluationConfig, evaluate, write_evaluation
from racines_envs.evaluation.trainings import find_trainings, published_run
from racines_envs.task.tasks import TASKS
from racines_leaderboard.cli.command import app
from racines_leaderboard.records.schema import read_json
from racines_models.protocol import Run
from racines_models.statistics import Evidence
from racines_models.training.sets import train_seeds
from racines_models.weights import publish as publish_weights
from tests.envs.fakes import FakePhantom
from tests.leaderboard.graphs import sound_policy

PPO = PPOConfig(
    frames=128, envs=8, update_every=128, minibatch=64, epochs=1, hidden=(16, 16),
    validation_starts=2,
)  # fmt: skip
FEW = EvaluationConfig(starts=5, seeds=(0,), latency=0)
POLICY = "policy.safetensors"
TINY = """
board: tiny
agents:
  pl: {agent: ppo, view: PL, frames: 256, envs: 8, update_every: 128, minibatch: 64, epochs: 1,
       hidden: [16, 16], validation_starts: 2, validate_every: 128, repeats: 2}
evaluation: {starts: 3, seeds: [0], latency: 0}
"""


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Return the folder of a run of three seeds, from 4 on."""
    folder = tmp_path_factory.mktemp("runs") / "ppo"

    def fit(run: Run):
        PPOAgent.train(PPO, run.folder, seed=run.seed, phantom=FakePhantom(), progress=False)
        return json.loads((run.folder / "metrics.json").read_text())

    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(TASKS, "SC", replace(TASKS["SC"], max_steps=30))
        train_seeds(fit, Run(folder, seed=4), 3)
    return folder


@pytest.fixture
def run(trained, tmp_path):
    """Return a copy of that run, to be changed."""
    return shutil.copytree(trained, tmp_path / "ppo")


def publish(run, tmp_path, *seeds):
    """Move seeds of a run to where published ones lie; return that place."""
    place = tmp_path / "weights/tiny/ppo"
    for seed in seeds:
        shutil.move(run / f"seed-{seed}", place / f"seed-{seed}")
    return place


@pytest.mark.usefixtures("short_episodes")
def test_all_trainings_of_a_run_act_from_the_same_starts(run, phantom, tmp_path):
    result = evaluate("ppo", run, FEW, phantom)
    write_evaluation(result, tmp_path / "ppo.json", None)
    scores = read_json(tmp_path / "ppo.json", "agent-scores")
    assert (scores["runs"], scores["trained"]) == (3, True)
    assert scores["trainings"] == [{"seed": seed, "published": False} for seed in (4, 5, 6)]
    files = scores["weights"]["files"]
    assert list(files) == [POLICY, f"seed-5/{POLICY}", f"seed-6/{POLICY}"]
    assert scores["weights"]["sha256"] == files[POLICY] and len(set(files.values())) == 3
    assert all(sha256_file(run / name) == sha256 for name, sha256 in files.items())
    values = Evidence.read(tmp_path / "ppo.parquet").figures["return"].values
    assert values is not None and values.shape == (3, 1, 5)
    for row, folder in enumerate((run, run / "seed-5", run / "seed-6")):
        alone = shutil.copytree(
            folder, tmp_path / f"alone-{row}", ignore=lambda *_: ["seed-5", "seed-6"]
        )
        one = evaluate("ppo", alone, FEW, phantom)
        own = one.evidence.figures["return"].values
        assert own is not None and np.array_equal(own[0], values[row]), "as if scored alone"
        assert one.scores["runs"] == 1 and "trainings" not in one.scores
    assert result.scores["metrics"]["return"]["settings"]["trainings"] == 3


def test_an_agent_that_is_open_already_is_one_training(run, phantom):
    agent = PPOAgent.load(run)
    assert evaluate("ppo", run, FEW, phantom, agent=agent).scores["runs"] == 1


@pytest.mark.usefixtures("short_episodes")
def test_published_trainings_go_on_where_the_run_ends(run, phantom, tmp_path):
    whole = evaluate("ppo", run, FEW, phantom).scores
    place = publish(run, tmp_path, 5, 6)
    assert [each.published for each in find_trainings(run, place)] == [False, True, True]
    scores = evaluate("ppo", run, FEW, phantom, published=place).scores
    assert scores["metrics"] == whole["metrics"] and scores["weights"] == whole["weights"]
    assert [each["published"] for each in scores["trainings"]] == [False, True, True]
    assert evaluate("ppo", run, FEW, phantom).scores["runs"] == 1
    shutil.copytree(place / "seed-5", run / "seed-5")
    assert [each.published for each in find_trainings(run, place)] == [False, False, True]
    where = tmp_path / "weights"
    assert published_run("tiny", "ppo", where) == place
    assert published_run("other", "ppo", where) is None is published_run(None, "ppo", where)


def change(path, **values):
    content = json.loads(path.read_text())
    content["config"] |= {k: v for k, v in values.items() if k in content["config"]}
    content |= {k: v for k, v in values.items() if k not in content["config"]}
    path.write_text(json.dumps(content))


@pytest.mark.parametrize(
    ("changed", "reason"),
    [({"frames": 99}, "frames"), ({"agent": "dqn"}, "agent"), ({"seed": 9}, "another seed")],
)
def test_what_is_no_training_of_the_same_method_does_not_count(
    run, tmp_path, capsys, changed, reason
):
    """A better one of other settings, say, under the name of a further seed."""
    change(run / "seed-5/config.json", **changed)
    with pytest.raises(
        RacinesError, match=f"seed-5: {'' if 'seed' in reason else 'another '}{reason}"
    ):
        find_trainings(run)
    place = publish(run, tmp_path, 5, 6)
    assert len(find_trainings(run, place)) == 1, "nor does what follows it"
    assert reason in capsys.readouterr().err
    change(place / "seed-5/config.json", frames=128, agent="ppo", seed=5, device="cuda")
    assert len(find_trainings(run, place)) == 3, "a device makes no other method"


def test_a_copy_in_half_precision_is_a_run_of_its_own(run, tmp_path):
    copy = tmp_path / "copy"
    publish_weights(run, copy)
    assert not list(copy.rglob("metrics.json"))
    assert [each.seed for each in find_trainings(copy)] == [4, 5, 6]
    told = json.loads((copy / "seed-5/config.json").read_text())
    told["training"]["phantom"] = {"version": "9"}
    (copy / "seed-5/config.json").write_text(json.dumps(told))
    with pytest.raises(RacinesError, match="another phantom"):
        find_trainings(copy)


def test_a_setting_that_was_yet_to_come_is_as_by_default(run):
    told = json.loads((run / "config.json").read_text())
    assert told["config"].pop("termination") == PPOConfig().termination
    (run / "config.json").write_text(json.dumps(told))
    assert [training.seed for training in find_trainings(run)] == [4, 5, 6]
    later = json.loads((run / "seed-5/config.json").read_text())
    later["config"]["termination"] = "first_hit"
    (run / "seed-5/config.json").write_text(json.dumps(later))
    with pytest.raises(RacinesError, match="another termination"):
        find_trainings(run)


def test_other_data_make_another_training(run):
    metrics = run / "seed-6/metrics.json"
    content = json.loads(metrics.read_text()) | {"data": {"recipe_digest": "ab", "digest": "1"}}
    metrics.write_text(json.dumps(content))
    with pytest.raises(RacinesError, match="seed-6: another dataset"):
        find_trainings(run)


def test_no_seed_is_left_out(run, tmp_path):
    shutil.rmtree(run / "seed-5")
    with pytest.raises(RacinesError, match="there is no seed-5"):
        find_trainings(run)
    place = publish(run, tmp_path, 6)
    assert len(find_trainings(run, place)) == 1


def test_a_copy_is_no_training(run):
    """Also where the file's bytes differ, since its header says something else."""
    further = run / f"seed-5/{POLICY}"
    save_file(load_file(run / POLICY), further, metadata={"note": "mine"})
    assert sha256_file(further) != sha256_file(run / POLICY)
    with pytest.raises(RacinesError, match="seed-5: the weights are those of"):
        find_trainings(run)


def test_what_learns_says_so(run, tmp_path):
    assert learns(PPOAgent) and not learns(PlannerAgent) and not learns(RandomAgent)
    sound_policy(tmp_path / "theirs.onnx")
    assert learns(OnnxPolicyAgent(tmp_path / "theirs.onnx"))
    sound_policy(tmp_path / "rule.onnx", card='{"trained": false}')
    assert not learns(OnnxPolicyAgent(tmp_path / "rule.onnx"))
    export_run(run, tmp_path / "ours.onnx")
    assert learns(OnnxPolicyAgent(tmp_path / "ours.onnx"))


def test_repeats_of_an_entry_are_read_and_refused():
    def entry(**values):
        return find_entry({"agents": {"x": {"agent": "ppo"} | values}}, "x")

    assert (entry().repeats, entry(repeats=3).repeats) == (1, 3)
    assert entry(repeats=3).settings == {}
    for wrong in (0, -1, True, "3", 1.5):
        with pytest.raises(RacinesError, match=r"agents\.x\.repeats: .*: give 1 or more"):
            entry(repeats=wrong)
    with pytest.raises(RacinesError, match="planner learns nothing"):
        entry(agent="planner", repeats=2)


def test_the_commands_train_several_go_on_after_a_kill_and_score_them(
    real_phantom, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(TASKS, "PL", replace(TASKS["PL"], max_steps=10))
    (tmp_path / "params.yaml").write_text(TINY)
    folder, validate, seen = tmp_path / "envs/runs/pl", TrainingRun._validate, []

    def command(*words):
        return CliRunner().invoke(app, words, catch_exceptions=False)

    def killed(self):
        seen.append((self.seed, self.frames))
        if seen[-1] == (1, 128) and len(seen) == 3:
            raise KeyboardInterrupt
        return validate(self)

    monkeypatch.setattr(TrainingRun, "_validate", killed)
    CliRunner().invoke(app, ["train", "agent", "pl", "--json"])
    assert seen == [(0, 128), (0, 256), (1, 128)] and not (folder / f"seed-1/{POLICY}").exists()
    first = (folder / POLICY).read_bytes()
    done = command("train", "agent", "pl", "--json")
    assert seen[3:] == [(1, 128), (1, 256)], "the first is not trained again"
    assert set(json.loads(done.stdout)["seeds"]) == {"0", "1"}
    assert (folder / POLICY).read_bytes() == first

    said = command("eval", "agent", "pl").stdout
    assert "trainings: seed 0, seed 1" in said
    scores = read_json(tmp_path / "envs/runs/scores/pl.json", "agent-scores")
    assert scores["runs"] == 2 and (tmp_path / "envs/runs/scores/pl.parquet").is_file()

    (tmp_path / "params.yaml").write_text(TINY.replace("repeats: 2", "repeats: 1"))
    command("train", "agent", "pl", "--seed", "1", "--out", "alone", "--json")
    alone = (tmp_path / "alone" / POLICY).read_bytes()
    assert alone == (folder / f"seed-1/{POLICY}").read_bytes(), "as with that seed alone"

    params = yaml.safe_load(TINY)
    params["agents"] |= {"pl-2": params["agents"]["pl"] | {"repeats": 1}, "other": {}}
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(params))
    both = command("train", "agent", "pl*", "--out", "both", "--json")
    assert [*json.loads(both.stdout)["trained"]] == ["both/pl", "both/pl-2"]
    for place in ("pl", "pl-2", "pl/seed-1"):
        own = folder / ("seed-1" if place.endswith("1") else "")
        assert (tmp_path / "both" / place / POLICY).read_bytes() == (own / POLICY).read_bytes()

    place = tmp_path / "envs/weights/tiny/pl"
    shutil.move(folder / "seed-1", place / "seed-1")
    said = command("eval", "agent", "pl", "--force").stdout
    assert "trainings: seed 0, seed 1 (published)" in said
    apart = ("--run", str(folder), "--name", "apart")
    assert "trainings:" not in command("eval", "agent", "pl", *apart).stdout, "--run is that folder"
