"""Policies as ONNX files: they act as the class does, and strangers' files are checked."""

import json
from dataclasses import replace

import pytest
import torch
from onnx import TensorProto, helper

from racines_data.errors import RacinesError
from racines_envs.agents import agent_class, load_agent
from racines_envs.agents.behaviour_cloning import BehaviourCloningAgent, BehaviourCloningConfig
from racines_envs.agents.networks import PoseEncoder
from racines_envs.agents.onnx.policy import OnnxPolicyAgent, export_policy, export_run
from racines_envs.agents.policy import make_actor
from racines_envs.agents.ppo import PPOAgent, PPOConfig
from racines_envs.agents.random import RandomAgent
from racines_envs.agents.rollout import rollout
from racines_envs.evaluation.run import EvaluationConfig, evaluate
from racines_envs.task.core import OBSERVATIONS
from racines_envs.task.starts import evaluation_seeds
from racines_envs.worlds.making import make_core


def policy(observation, encoder=None, cls=PPOAgent, config=None):
    """Return an agent whose weights are drawn: its actions differ from row to row."""
    torch.manual_seed(1)
    config = config or PPOConfig(observation=observation, hidden=(32, 32))
    actor = make_actor(config, encoder).eval()
    with torch.no_grad():
        for value in actor.head.parameters():
            value.normal_()
        for module in actor.modules():  # normalisation must be in the file as it was learned
            if isinstance(module, (torch.nn.BatchNorm1d, torch.nn.BatchNorm2d)):
                assert module.running_mean is not None and module.running_var is not None
                module.running_mean.normal_(0, 0.1)
                module.running_var.uniform_(0.5, 2.0)
    return cls(config, actor, encoder)


def pose_encoder():
    from racines_models.judges.pose.regressor import PoseNetwork

    torch.manual_seed(2)
    network = PoseNetwork(64, 0.125).eval()
    return PoseEncoder(network, "e" * 64)


def starts(observation, phantom, count=30):
    core = make_core("SC", count, observation=observation, reward="oracle", phantom=phantom)
    return core, core.reset(seed=0)


@pytest.mark.parametrize("observation", OBSERVATIONS)
def test_acts_exactly_as_the_class(observation, phantom, tmp_path):
    agent = policy(observation)
    made = export_policy(agent, tmp_path / "policy.onnx")
    assert made["bytes"] == (tmp_path / "policy.onnx").stat().st_size
    opened = load_agent(str(tmp_path / "policy.onnx"), tmp_path / "nowhere")
    core, seen = starts(observation, phantom)
    seeds = core.decision_seeds()
    torch.testing.assert_close(opened.logits(seen), agent.logits(seen), atol=1e-4, rtol=1e-4)
    assert torch.equal(opened.act(seen, seeds), agent.act(seen, seeds))
    assert opened.observation == observation and opened.view == "SC"
    alone = {key: value[4:5] for key, value in seen.items()}
    assert torch.equal(opened.logits(alone), opened.logits(seen)[4:5])


@pytest.mark.thorough
@pytest.mark.parametrize("observation", ["multimodal", "image"])
def test_a_frozen_encoder_is_part_of_the_file(observation, phantom, tmp_path):
    agent = policy(observation, pose_encoder())
    export_policy(agent, tmp_path / "policy.onnx")
    opened = OnnxPolicyAgent(tmp_path / "policy.onnx")
    core, seen = starts(observation, phantom, 9)
    torch.testing.assert_close(opened.logits(seen), agent.logits(seen), atol=1e-3, rtol=1e-3)
    assert torch.equal(
        opened.act(seen, core.decision_seeds()), agent.act(seen, core.decision_seeds())
    )
    assert opened.interface.card["encoder"] == "e" * 64


@pytest.mark.usefixtures("short_episodes")
def test_a_temperature_draws_the_same_actions(phantom, tmp_path):
    config = BehaviourCloningConfig(observation="params", hidden=(32, 32), temperature=3.0)
    agent = policy("params", cls=BehaviourCloningAgent, config=config)
    export_policy(agent, tmp_path / "policy.onnx")
    core, _ = starts("params", phantom)
    seeds = evaluation_seeds(30)
    ours = rollout(core, agent, seeds)
    theirs = rollout(core, OnnxPolicyAgent(tmp_path / "policy.onnx"), seeds)
    assert (ours.positions == theirs.positions).all()


@pytest.mark.usefixtures("short_episodes")
def test_a_run_is_exported_with_its_card_and_evaluated_by_its_path(phantom, tmp_path):
    agent = policy("params")
    agent.save(tmp_path / "run", {"phantom": {"version": "9"}, "history": []}, 5)
    path = tmp_path / "best.onnx"
    made = export_run(tmp_path / "run", path)
    assert made["observation"] == "params"
    card = OnnxPolicyAgent(path).interface.card
    assert card["agent"] == "ppo" and card["view"] == "SC" and card["seed"] == 5
    assert card["phantom"] == {"version": "9"} and card["config"]["hidden"] == [32, 32]
    assert agent_class(str(path)) is OnnxPolicyAgent
    config = EvaluationConfig(starts=4, seeds=(0,), resamples=20)
    scores = evaluate(str(path), tmp_path, config, phantom).scores
    assert scores["weights"]["sha256"] == OnnxPolicyAgent(path).sha256
    assert scores["task"]["observation"] == "params"
    with pytest.raises(RacinesError, match="trained for SC"):
        evaluate(str(path), tmp_path, replace(config, view="PL"), phantom)


def test_the_command_writes_a_file(tmp_path):
    from typer.testing import CliRunner

    from racines_leaderboard.cli.command import app

    policy("params").save(tmp_path / "run", {}, 0)
    words = ["export", "agent", str(tmp_path / "run"), "--json", "--out"]
    done = CliRunner().invoke(app, [*words, str(tmp_path / "p.onnx")], catch_exceptions=False)
    assert done.exit_code == 0 and json.loads(done.stdout)["observation"] == "params"
    assert CliRunner().invoke(app, [*words, str(tmp_path / "p.bin")]).exit_code == 2
    missing = CliRunner().invoke(app, ["export", "agent", "nowhere", "--out", "p.onnx"])
    assert isinstance(missing.exception, RacinesError)


def graph(inputs, outputs=(("logits", TensorProto.FLOAT, ("B", 13)),), nodes=None, **told):
    """Return a model of one constant, with the inputs and outputs that are told."""
    values = [helper.make_tensor_value_info(*one) for one in inputs]
    ends = [helper.make_tensor_value_info(*one) for one in outputs]
    # logits = params reduced to one column, times a row of numbers
    row = helper.make_tensor("row", TensorProto.FLOAT, [1, 13], [float(i) for i in range(13)])
    axes = helper.make_tensor("axes", TensorProto.INT64, [1], [1])
    nodes = nodes or [
        helper.make_node("ReduceSum", [inputs[0][0], "axes"], ["sum"], keepdims=1),
        helper.make_node("MatMul", ["sum", "row"], [outputs[0][0]]),
    ]
    made = helper.make_graph(nodes, "g", values, ends, [row, axes])
    model = helper.make_model(made, opset_imports=[helper.make_opsetid("", 18)])
    model.ir_version = 9
    for key, value in told.items():
        entry = model.metadata_props.add()
        entry.key, entry.value = f"racines.{key}", value
    return model


PARAMS = ("params", TensorProto.FLOAT, ("B", 9))


def test_another_programs_file_serves_without_metadata(phantom, tmp_path):
    (tmp_path / "policy.onnx").write_bytes(graph([PARAMS]).SerializeToString())
    agent = load_agent("onnx", tmp_path)
    assert not hasattr(agent, "view") and agent.observation == "params"
    up = {"params": torch.ones(10, 9)}
    assert agent.act(up, evaluation_seeds(10)).tolist() == [12] * 10
    assert agent.act({"params": -up["params"]}, evaluation_seeds(10)).tolist() == [0] * 10


@pytest.mark.parametrize(
    ("model", "reason"),
    [
        (graph([("pose", TensorProto.FLOAT, ("B", 9))]), "give image, params, or both"),
        (graph([("params", TensorProto.FLOAT, ("B", 12))]), r"float32 \(B, 9\)"),
        (graph([("params", TensorProto.DOUBLE, ("B", 9))]), r"float32 \(B, 9\)"),
        (graph([PARAMS], [("action", TensorProto.FLOAT, ("B", 13))]), "give one, logits"),
        (graph([PARAMS], [("logits", TensorProto.FLOAT, ("B", 12))]), r"float32 \(B, 13\)"),
        (graph([("params", TensorProto.FLOAT, (4096, 9))]), "fixed batch of 4096"),
        (graph([PARAMS], temperature="-1"), "temperature"),
        (graph([PARAMS], temperature="hot"), "temperature"),
        (graph([PARAMS], reward="high"), "racines.reward: unknown"),
        (graph([PARAMS], schema="racines.onnx-generator/1"), "racines.onnx-policy/1"),
        (graph([PARAMS], name="../up"), "racines.name"),
    ],
)
def test_files_of_another_interface_are_refused(model, reason, tmp_path):
    path = tmp_path / "policy.onnx"
    path.write_bytes(model.SerializeToString())
    with pytest.raises(RacinesError, match=reason):
        OnnxPolicyAgent(path)


def test_what_comes_out_is_checked_too(tmp_path):
    (tmp_path / "policy.onnx").write_bytes(graph([PARAMS]).SerializeToString())
    agent = OnnxPolicyAgent(tmp_path / "policy.onnx")
    with pytest.raises(RacinesError, match="not finite"):
        agent.act({"params": torch.full((2, 9), torch.nan)}, evaluation_seeds(2))
    with pytest.raises(RacinesError, match="needs params"):
        agent.act({"image": torch.zeros(2, 128, 128)}, evaluation_seeds(2))
    with pytest.raises(RacinesError, match="no network"):
        export_policy(RandomAgent(), tmp_path / "random.onnx")
    with pytest.raises(RacinesError, match="export"):
        OnnxPolicyAgent.train(None, tmp_path)
    with pytest.raises(RacinesError, match="no such file"):
        load_agent(str(tmp_path / "none.onnx"), tmp_path)
