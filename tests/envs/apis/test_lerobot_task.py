"""The format of the tasks: exports and environments that fit, and the way back as ONNX."""

import ast
import json
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from torch import Tensor, nn

from racines_data.errors import RacinesError
from racines_data.export.lerobot import task_of
from racines_data.export.registry import load_exporter
from racines_data.geometry import euler_to_matrix, matrix_from_6d
from racines_data.records import float_columns
from racines_data.schema import CONTROLS, PARAMETERS
from racines_data.store.sweeps import read_sweeps
from racines_envs.agents.onnx.policy import OnnxPolicyAgent
from racines_envs.apis.lerobot import LeRobotEnv, to_onnx, write_envhub
from racines_envs.apis.lerobot.formats import FORMATS, TASK, features_of, twist_of
from racines_envs.task.motion import Velocity
from racines_envs.task.tasks import get_task
from racines_envs.worlds.making import make_core

LIMITS = Velocity(get_task("SC"), "cpu").limits


@pytest.fixture(scope="module")
def exported(tiny_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("task") / "export"
    load_exporter(TASK)(tiny_root, out)
    return out


def test_it_exports_what_agents_see_and_twists_of_the_probe(exported: Path, tiny_root: Path):
    table = pq.read_table(exported / "data")
    state = torch.tensor(table["observation.state"].to_pylist())
    action = torch.tensor(table["action"].to_pylist())
    sweeps = list(read_sweeps(tiny_root))
    held = torch.from_numpy(np.concatenate([float_columns(s.table, PARAMETERS) for s in sweeps]))
    moved = torch.from_numpy(np.concatenate([float_columns(s.table, CONTROLS) for s in sweeps]))
    rotation = euler_to_matrix(held[:, 9:])
    space = make_core("SC").phantom.workspace
    low, high = space.position_min, space.position_max
    inside = (2.0 * (held[:, 6:9] - low) / (high - low) - 1.0).clamp(-1.0, 1.0)
    assert torch.allclose(state[:, :3], inside, atol=1e-5)
    assert torch.allclose(matrix_from_6d(state[:, 3:]), rotation, atol=1e-5)
    for part in (slice(0, 3), slice(3, 6)):
        own = (rotation.transpose(1, 2) @ moved[:, part, None])[..., 0]
        most = LIMITS[part]
        assert torch.allclose(action[:, part], own.clamp(-most, most), atol=1e-5)
    assert (action.abs().amax(0) <= LIMITS).all() and (action.abs() < LIMITS).any()


def test_its_metadata_name_episodes_by_target(exported: Path, tiny_root: Path):
    told = json.loads((exported / "meta/racines.json").read_text())["episodes"]
    sweeps = list(read_sweeps(tiny_root))
    for split, aims in told.items():
        for view, episodes in aims.items():
            assert {sweeps[i].first("target_view") for i in episodes} == {view}
            assert {sweeps[i].split for i in episodes} == {split}
    assert sum(len(e) for aims in told.values() for e in aims.values()) == len(sweeps)
    assert "twist in the probe's frame" in (exported / "README.md").read_text()


@pytest.mark.parametrize("name", FORMATS)
def test_exports_environments_and_the_folders_settings_fit(
    name: str, tiny_root: Path, tmp_path: Path, phantom: Any
):
    """What LeRobot trains on is what it is shown, and what `lerobot-eval` is told of."""
    load_exporter(name)(tiny_root, tmp_path / "export", limit=30)
    info = json.loads((tmp_path / "export/meta/info.json").read_text())["features"]
    features = features_of(name)
    env = LeRobotEnv("SC", name, phantom=phantom)
    seen = env.reset(seed=1)[0]
    shapes = {"pixels/ultrasound": seen["pixels"]["ultrasound"].shape}
    shapes |= {"agent_pos": seen["agent_pos"].shape, "action": env.action_space.shape}
    assert {key: shape for key, (_, shape) in features.items()} == shapes
    write_envhub(tmp_path / "hub", ["SC"], name)
    plugin = (tmp_path / "hub/lerobot_env_racines/__init__.py").read_text()
    constants = {
        node.targets[0].id: ast.literal_eval(node.value)
        for node in ast.parse(plugin).body
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
    }
    assert constants["FEATURES"] == features
    for key, called in constants["NAMES"].items():
        assert tuple(info[called]["shape"]) == shapes[key]
    assert name in (tmp_path / "hub/README.md").read_text()
    assert env.task_description == task_of("SC", "Random")


def test_the_environment_shows_what_agents_see(phantom: Any):
    env = LeRobotEnv("SC", TASK, phantom=phantom)
    check_env(env, skip_render_check=True)
    seen, _ = env.reset(seed=1)
    core = make_core("SC", observation="multimodal", phantom=phantom)
    shown = core.reset(1)
    assert np.array_equal(seen["agent_pos"], shown["params"][0].numpy())
    assert np.array_equal(seen["pixels"]["ultrasound"][..., 1], shown["image"][0].numpy())


def test_a_twist_and_its_velocity_in_the_base_frame_move_alike(phantom: Any):
    twist = torch.tensor([[0.02, -0.01, 0.0, 0.1, 0.3, -0.2]])
    ends = []
    for name in FORMATS:
        env = LeRobotEnv("SC", name, phantom=phantom)
        env.reset(seed=1)
        turned = env._env.core.state.rotation.float()
        back = twist_of(twist, turned.transpose(1, 2))
        assert torch.allclose(twist_of(back, turned), twist, atol=1e-6)
        env.step((twist if name == TASK else back)[0].numpy())
        ends.append(env._env.core.state.pose)
    assert all(torch.allclose(a, b, atol=1e-6) for a, b in zip(*ends, strict=True))


def test_other_formats_and_drawn_goals_are_refused(tmp_path: Path):
    with pytest.raises(RacinesError, match="--format hdf5: choose one of lerobot-rgb"):
        write_envhub(tmp_path / "hub", ["SC"], "hdf5")
    assert not (tmp_path / "hub").exists()
    with pytest.raises(RacinesError, match="see no goal: name a view"):
        LeRobotEnv("AnyView-patients")


class Model(nn.Module):
    """As ACT's network: from normalised observations to a chunk of normalised actions."""

    def __init__(self) -> None:
        super().__init__()
        torch.manual_seed(0)
        self.look, self.feel = nn.Linear(3, 12), nn.Linear(9, 12)

    def forward(self, batch: dict[str, Any]) -> tuple[Tensor, None]:
        (image,) = batch["observation.images"]
        made = self.look(image.mean((2, 3))) + self.feel(batch[to_onnx.STATE])
        return made.view(-1, 2, 6), None


@dataclass
class Step:
    """A step of LeRobot's pipelines that scales."""

    features: dict[str, Any]
    stats: dict[str, Any]
    norm_map: dict[str, str]
    _registry_name: ClassVar[str] = "normalizer_processor"
    eps: float = 1e-8
    rename_map: dict[str, str] = field(default_factory=dict)


def pipelines(mode: str = "MIN_MAX") -> tuple[Any, Any]:
    kinds = {to_onnx.IMAGE: "VISUAL", to_onnx.STATE: "STATE", to_onnx.ACTION: "ACTION"}
    features = {name: SimpleNamespace(type=kind) for name, kind in kinds.items()}
    three, nine = [[[0.25]]] * 3, [0.5] * 9
    stats = {
        to_onnx.IMAGE: {"mean": three, "std": three},
        to_onnx.STATE: {"min": [-1.0] * 9, "max": nine},
        to_onnx.ACTION: {"mean": [0.001] * 6, "std": [0.01] * 3 + [0.1] * 3},
    }
    modes = {"VISUAL": "MEAN_STD", "STATE": mode, "ACTION": "MEAN_STD"}
    step = Step(features, stats, modes)
    return SimpleNamespace(steps=[step]), SimpleNamespace(steps=[step])


NAMES = [to_onnx.IMAGE, to_onnx.STATE]


def test_a_network_of_lerobot_becomes_a_policy_of_the_board(tmp_path: Path):
    policy = nn.Module()
    policy.model = Model()
    board = to_onnx.BoardPolicy(policy, to_onnx.scalings_of(*pipelines(), NAMES))
    to_onnx.write(board, True, tmp_path / "p.onnx", "SC", {"agent": "lerobot-act"})
    agent = OnnxPolicyAgent(tmp_path / "p.onnx")
    assert (agent.view, agent.observation, agent.action) == ("SC", "multimodal", "velocity")
    core = make_core("SC", 3, observation="multimodal", action="velocity")
    seen = core.reset(2)
    pixels = (seen["image"].float() / 255 - 0.25) / 0.25  # by hand
    state = 2.0 * (seen["params"] + 1.0) / 1.5 - 1.0
    with torch.no_grad():
        batch = {to_onnx.STATE: state}
        batch["observation.images"] = [pixels[:, None].expand(-1, 3, -1, -1)]  # pyright: ignore
        chunk, _ = policy.model(batch)
    wanted = chunk[:, 0] * torch.tensor([0.01] * 3 + [0.1] * 3) + 0.001
    assert torch.allclose(agent.logits(seen), wanted, atol=1e-6)
    assert not list(tmp_path.glob(".*.part"))
    core.step(agent.act(seen, torch.zeros(3, dtype=torch.int64)))


def config(state: int = 9, **other: Any) -> Any:
    def shapes(of: dict[str, tuple[int, ...]]) -> dict[str, Any]:
        return {name: SimpleNamespace(shape=shape) for name, shape in of.items()}

    seen = shapes({to_onnx.IMAGE: (3, 128, 128), to_onnx.STATE: (state,)})
    made = {"input_features": seen, "output_features": shapes({to_onnx.ACTION: (6,)})}
    return SimpleNamespace(**({"type": "act", "temporal_ensemble_coeff": None} | made | other))


def test_what_is_no_policy_of_the_board_is_refused(tmp_path: Path, capsys: Any):
    to_onnx.check_config(config())
    for given, message in (
        (config(type="diffusion"), "only act"),
        (config(temporal_ensemble_coeff=0.01), "no memory"),
        (config(state=12), "train it on an export of --format lerobot-task"),
    ):
        with pytest.raises(to_onnx.Refused, match=message):
            to_onnx.check_config(given)
    with pytest.raises(to_onnx.Refused, match="normalisation QUANTILES"):
        to_onnx.scalings_of(*pipelines("QUANTILES"), NAMES)
    odd = SimpleNamespace(steps=[SimpleNamespace(rename_map={"a": "b"})])
    with pytest.raises(to_onnx.Refused, match="not known here"):
        to_onnx.scalings_of(odd, odd, NAMES)
    assert to_onnx.main([str(tmp_path), str(tmp_path / "p.onnx")]) == 1
    assert "no config.json" in capsys.readouterr().err and not (tmp_path / "p.onnx").exists()
