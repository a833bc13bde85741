"""Sweeps that were drawn for an arm, of the one heart and of patients: its joints in exports."""

import json
from pathlib import Path

import gymnasium
import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from gymnasium.envs.registration import EnvSpec
from pyarrow import ipc

from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.export.registry import for_config, load_exporter
from racines_data.geometry import parameters_to_pose
from racines_data.records import float_columns
from racines_data.schema import PARAMETERS
from racines_data.sources.patients import SWEEPS, PatientsSource
from racines_data.sources.phantom import PhantomSource
from racines_data.store.sweeps import read_sweeps
from racines_envs.apis.lerobot import LeRobotEnv
from racines_envs.apis.lerobot.formats import FORMATS
from racines_envs.recordings.minari import patients_spec

pytest.importorskip("pytorch_kinematics")
from racines_envs.robots.following import _shared_robot, hurry
from racines_envs.robots.ur5e import UR5E

FRAMES, OUT_OF_REACH = 40, 10_031
"""Frames of a patient's sweep; a patient whose apical window an arm at the origin cannot reach."""
JOINTS = "observation.joints"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a dataset of two sweeps of the one heart and six of a patient, by an arm."""
    out = tmp_path_factory.mktemp("arm") / "racines"
    heart = {"frames": 200, "shortest": 90, "longest": 110, "robot": "ur5e"}
    build(PhantomSource.from_config(heart, ()), out, DataConfig(workers=1))
    patient = {"validation": [OUT_OF_REACH], "frames_per_sweep": FRAMES, "robot": "ur5e"}
    build(PatientsSource.from_config(patient), out, DataConfig(workers=1))
    return out


def test_an_arm_can_follow_every_sweep_of_a_patient_out_of_its_reach_too(root: Path):
    sweeps = list(read_sweeps(root, config="patients"))
    assert len(sweeps) == 6
    for sweep in sweeps:
        parameters = torch.from_numpy(float_columns(sweep.table, PARAMETERS)).double()
        # Measured poses: with what noise adds to a move.
        assert float(hurry("ur5e", parameters_to_pose(parameters), SWEEPS.rate).max()) < 1.05
    aimed = next(sweep for sweep in sweeps if sweep.first("target_view") == "A4C")
    assert (aimed.table["view"].to_numpy() == 0).sum() < 10, "it falls short of the view"


@pytest.mark.parametrize("config", ["frames", "patients"])
def test_lerobot_has_the_joints_at_which_the_arm_holds_each_pose(
    config: str, root: Path, tmp_path: Path
):
    out = tmp_path / "out"
    for_config(load_exporter("lerobot"), config, "lerobot")(root, out)
    info = json.loads((out / "meta/info.json").read_text())
    assert info["robot_type"] == "ur5e"
    assert info["features"][JOINTS]["names"] == [f"joint_{i}" for i in range(1, 7)]
    assert len(json.loads((out / "meta/stats.json").read_text())[JOINTS]["mean"]) == 6
    (path,) = (out / "data").rglob("*.parquet")
    table = pq.read_table(path)
    joints = np.stack(table[JOINTS].to_numpy())
    state = torch.from_numpy(np.stack(table["observation.state"].to_numpy())).double()
    there, _ = _shared_robot("ur5e").kinematics._look(torch.from_numpy(joints).double())
    told = parameters_to_pose(state)
    assert torch.allclose(there.position, told.position, atol=1e-6)
    assert torch.allclose(there.rotation, told.rotation, atol=1e-5)
    low, high = np.array(UR5E.limits).T
    assert (joints >= low).all() and (joints <= high).all()


@pytest.mark.parametrize("name", FORMATS)
def test_a_policy_is_shown_in_a_task_what_its_export_has(name: str, root: Path, tmp_path: Path):
    load_exporter(name)(root, tmp_path / "out")
    (path,) = (tmp_path / "out/data").rglob("*.parquet")
    row = pq.read_table(path).slice(0, 1).to_pylist()[0]
    written = json.loads((tmp_path / "out/meta/info.json").read_text())["features"]
    env = LeRobotEnv("SC", name, robot="ur5e")
    parameters = float_columns(next(read_sweeps(root)).table, PARAMETERS)[0]
    seen, _ = env.reset(seed=1, options={"pose": parameters[6:]})
    assert {*seen, "action"} == {"pixels", "agent_pos", "joints", "action"}
    for key, called in (("agent_pos", "observation.state"), ("joints", JOINTS)):
        assert list(seen[key].shape) == written[called]["shape"]
    assert np.allclose(seen["joints"], row[JOINTS], atol=1e-5)
    assert np.allclose(seen["agent_pos"][-6:], row["observation.state"][-6:], atol=1e-5)


@pytest.mark.parametrize("config", ["frames", "patients"])
def test_minari_has_them_and_an_environment_with_the_arm(config: str, root: Path, tmp_path: Path):
    for_config(load_exporter("minari"), config, "minari")(root, tmp_path / "out")
    recovered = 0
    for data in sorted((tmp_path / "out").rglob("*-v*/data")):
        metadata = json.loads((data / "metadata.json").read_text())
        spaces = json.loads(metadata["observation_space"])["subspaces"]
        assert spaces["joints"]["shape"] == [6] and "those of a ur5e" in metadata["description"]
        batch = ipc.open_file(data / "0/part-0.arrow").get_batch(0)
        joints = np.array(batch["observations"].field("joints").to_pylist())
        assert joints.shape == (len(batch), 6) and np.isfinite(joints).all()
        if "env_spec" not in metadata:
            continue  # no sweep of the split aims at a view
        spec = EnvSpec.from_json(metadata["env_spec"])
        assert spec.kwargs["robot"] == "ur5e"
        recovered += 1
        if config == "frames":
            seen, _ = gymnasium.make(spec).reset(seed=1)
            assert set(seen) == {"image", "params", "joints"}
            moved = gymnasium.make(spec, action="velocity")  # as `recover_environment` does
            assert moved.action_space.shape == (len(batch["actions"][0]),)
    assert recovered


def test_a_free_probe_has_none():
    spec = patients_spec("patients", "validation", ["A4C"])
    assert spec is not None and "robot" not in json.loads(spec)["kwargs"]
    for source in (PatientsSource, PhantomSource):
        told = source.from_config({"train": 1} if source is PatientsSource else {}, ()).recipe()
        assert "robot" not in told["acquisition"] and "robot" not in told.get("settings", {})


def test_sweeps_too_short_and_arms_of_no_name_are_refused():
    short = {"validation": [10_000], "frames_per_sweep": 12, "robot": "ur5e"}
    source = PatientsSource.from_config(short)
    wanted = r"data.patients.robot: patient 10000, \w+: a sweep of 12 .*: raise frames_per_sweep"
    with pytest.raises(RacinesError, match=wanted):
        for unit in reversed(source.plan()):
            source.produce(unit)
    with pytest.raises(RacinesError, match="robot 'kuka'"):
        PatientsSource.from_config({"validation": 1, "robot": "kuka"})
