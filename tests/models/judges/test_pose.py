"""The pose regressor: what it learns, how it is kept, and the command that trains it."""

import json
from pathlib import Path

import pyarrow as pa
import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import (
    Pose,
    axis_angle_to_matrix,
    geodesic,
    matrix_from_6d,
    parameters_to_pose,
    rotation_6d,
)
from racines_data.store.hearts import columns, hearts_of, to_heart
from racines_models.judges.pose.regressor import (
    PoseConfig,
    PoseNetwork,
    PoseRegressor,
    PoseTraining,
)
from racines_models.judges.pose.training import pose_errors, report, train_pose
from racines_models.protocol import Run
from racines_models.weights import publish
from tests.conftest import ROOT
from tests.models.conftest import FakeStore, random_parameters


class PosedStore(FakeStore):
    """Pictures that follow the pose, in sweeps of eight frames."""

    def __init__(self):
        super().__init__(train=960)
        self.trajectory_index = torch.arange(len(self.images)) // 8


@pytest.fixture(scope="module")
def posed():
    return PosedStore()


def config(images: int = 320, **training) -> PoseConfig:
    settings = {"batch_size": 32, "warmup_images": 64, "precision": "fp32"} | training
    return PoseConfig(width=0.125, training=PoseTraining(images=images, **settings))


def test_rotations_come_back_from_six_numbers():
    rotation = axis_angle_to_matrix(torch.randn(20, 3, dtype=torch.float64))
    assert torch.allclose(matrix_from_6d(rotation_6d(rotation)), rotation)
    inexact = matrix_from_6d(torch.randn(20, 6, dtype=torch.float64))
    identity = torch.eye(3, dtype=torch.float64).expand(20, 3, 3)
    assert torch.allclose(inexact @ inexact.mT, identity)
    assert torch.allclose(torch.linalg.det(inexact), torch.ones(20, dtype=torch.float64))


def test_errors_are_in_millimetres_and_degrees():
    parameters = random_parameters(6, 0)
    pose = parameters_to_pose(parameters.double())
    turn = axis_angle_to_matrix(torch.tensor([0.0, 0.0, 0.1], dtype=torch.float64))
    moved = pose._replace(
        position=pose.position + torch.tensor([0.003, 0.004, 0.0]), rotation=pose.rotation @ turn
    )
    millimetres, degrees = pose_errors(moved, parameters)
    assert torch.allclose(millimetres, torch.full((6,), 5.0, dtype=torch.float64))
    assert torch.allclose(degrees, torch.full((6,), 5.729578, dtype=torch.float64))


def test_targets_are_standardised_and_turn_back_into_poses(posed):
    network = PoseNetwork(64, 0.125)
    network.fit_targets(posed.parameters[:960])
    targets = network.targets(posed.parameters[:960])
    assert torch.allclose(targets.mean(0), torch.zeros(9), atol=1e-3)
    assert torch.allclose(targets.std(0), torch.ones(9), atol=1e-3)
    found, true = network.pose(targets), parameters_to_pose(posed.parameters[:960])
    assert torch.allclose(found.position, true.position, atol=1e-6)
    assert float(geodesic(found.rotation, true.rotation).max()) < 1e-3


def test_it_learns_where_a_picture_was_taken(posed, tmp_path):
    metrics = train_pose(posed, config(2880), Run(tmp_path, 0, "cpu", progress=False))
    assert metrics["metrics"]["pose_error_mm"]["n"] == 16
    network = PoseNetwork(64, 0.125)
    network.fit_targets(posed.parameters[posed.split_indices("train")])
    frames = posed.take(posed.split_indices("test"))
    guess, _ = pose_errors(network.pose(torch.zeros(16, 9)), frames.parameters)
    # x and y can be seen in the picture, z cannot.
    found, _ = pose_errors(PoseRegressor.load(tmp_path).predict(frames.images), frames.parameters)
    assert float(found.median()) < 0.75 * float(guess.median())


def test_seeds_decide_the_weights(posed, tmp_path):
    for name, seed in (("a", 1), ("b", 2)):
        train_pose(
            posed, config(64, warmup_images=0), Run(tmp_path / name, seed, "cpu", progress=False)
        )
    a, b = (PoseRegressor.load(tmp_path / name) for name in "ab")
    assert a.sha256 != b.sha256


def test_weights_are_kept_whole_or_in_half_precision(posed, tmp_path):
    network = PoseNetwork(64, 0.125)
    network.fit_targets(posed.parameters)
    regressor = PoseRegressor(network, config())
    regressor.save(tmp_path / "run", seed=3)
    images = posed.images[:5]
    expected = regressor.predict(images)
    again = PoseRegressor.load(tmp_path / "run")
    assert torch.equal(again.predict(images).position, expected.position)
    assert again.settings["sha256"] == regressor.sha256 is not None
    publish(tmp_path / "run", tmp_path / "half")
    half = PoseRegressor.load(tmp_path / "half").predict(images)
    assert torch.allclose(half.position, expected.position, atol=2e-4)
    sizes = [(tmp_path / name / "model.safetensors").stat().st_size for name in ("half", "run")]
    assert sizes[0] < 0.7 * sizes[1]
    batches = [regressor.predict(images[:2]).rotation, regressor.predict(images[2:]).rotation]
    assert torch.allclose(torch.cat(batches), expected.rotation, atol=1e-5)


def test_what_cannot_be_used_is_refused(posed, tmp_path):
    with pytest.raises(RacinesError, match="train pose"):
        PoseRegressor.load(tmp_path)
    regressor = PoseRegressor(PoseNetwork(64, 0.125), config())
    regressor.save(tmp_path)
    weights = tmp_path / "model.safetensors"
    weights.write_bytes(weights.read_bytes()[:-1] + b"\0")
    with pytest.raises(RacinesError, match="model.safetensors"):
        PoseRegressor.load(tmp_path)
    (tmp_path / "config.json").write_text(json.dumps({"schema": "racines.grader/1"}))
    with pytest.raises(RacinesError, match="schema 'racines.grader/1'"):
        PoseRegressor.load(tmp_path)
    with pytest.raises(RacinesError, match="pose.input_size 50"):
        PoseConfig(input_size=50)
    with pytest.raises(RacinesError, match="uint8"):
        regressor.predict(posed.images[:2].float())
    posed = PosedStore()
    posed._splits["train"] = [0, 0]
    with pytest.raises(RacinesError, match="train split is empty"):
        train_pose(posed, config(), Run(tmp_path, 0, "cpu", progress=False))


def test_the_weights_in_the_repository_read_real_poses():
    folder = ROOT / "models/weights/pose"
    assert PoseRegressor.load(folder).config.input_size == 64
    content = json.loads((folder / "config.json").read_text())
    metrics = content["training"]["metrics"]
    assert content["training"]["split"] == "test" and metrics["pose_error_mm"]["n"] > 20_000
    assert metrics["pose_error_mm"]["value"] <= 3 and metrics["pose_error_deg"]["value"] <= 4
    assert (folder / "model.safetensors").stat().st_size < 25e6


def test_the_report_tells_frames_of_a_view_apart(posed):
    network = PoseNetwork(64, 0.125)
    regressor = PoseRegressor(network, config())
    rows = posed.split_indices("test")
    posed.views[rows[:4]] = len(posed.labels) - 1
    metrics = report(regressor, posed)["metrics"]
    assert metrics["pose_error_mm"]["n"] == 16 and metrics["pose_error_deg_view"]["n"] == 12
    frames = posed.take(rows)
    millimetres, _ = pose_errors(regressor.predict(frames.images), frames.parameters)
    value = metrics["pose_error_mm"]["value"]
    assert value == pytest.approx(float(millimetres.quantile(0.5)), rel=1e-5)
    assert metrics["pose_error_mm"]["low"] <= value <= metrics["pose_error_mm"]["high"]


class PatientsStore(PosedStore):
    """The same of patients: three sweeps each, frames told in the base frame."""

    def __init__(self):
        super().__init__()
        self.root, self.config = Path("data/racines"), "patients"
        self.patients = [1 + sweep // 3 for sweep in range(len(self.images) // 8)]
        self.phases = torch.rand(len(self.images), 2, generator=torch.Generator().manual_seed(3))
        people = sorted(set(self.patients))
        g = torch.Generator().manual_seed(4)
        turns = axis_angle_to_matrix(torch.randn(len(people), 3, generator=g, dtype=torch.float64))
        shifts = 0.05 * torch.randn(len(people), 2, 3, generator=g, dtype=torch.float64)
        rows = [columns(axes, *shift) for axes, shift in zip(turns, shifts, strict=True)]
        table = {name: [row[name] for row in rows] for name in rows[0]}
        self.table = pa.table({"patient": people} | table)

    def measures(self) -> pa.Table:
        return self.table


def test_of_patients_it_learns_poses_about_their_hearts(tmp_path):
    store = PatientsStore()
    metrics = train_pose(
        store, config(64, warmup_images=0), Run(tmp_path, 0, "cpu", progress=False)
    )
    regressor = PoseRegressor.load(tmp_path)
    assert regressor.config.frame == "heart" and regressor.settings["frame"] == "heart"

    def true(split: str) -> Pose:
        rows = store.split_indices(split)
        pose = parameters_to_pose(store.parameters[rows].double())
        return to_heart(pose, hearts_of(store, rows), store.phases[rows, 1])

    found = regressor.predict(store.images[store.split_indices("test")])
    millimetres = (found.position.double() - true("test").position).norm(dim=1) * 1e3
    told = metrics["metrics"]["pose_error_mm"]["value"]
    assert told == pytest.approx(float(millimetres.quantile(0.5)), rel=1e-4)
    again = report(regressor, store)["metrics"]["pose_error_mm"]
    assert again == metrics["metrics"]["pose_error_mm"]
    # Its standardised targets are about the heart too, not only what it is held to.
    guess = regressor.network.pose(torch.zeros(1, 9)).position[0]
    assert torch.allclose(guess.double(), true("train").position.mean(0), atol=1e-6)


def test_poses_about_hearts_need_a_dataset_that_says_where_they_lie(posed, tmp_path):
    with pytest.raises(RacinesError, match="pose.frame 'chest': choose one of base, heart"):
        PoseConfig(frame="chest")
    regressor = PoseRegressor(PoseNetwork(64, 0.125), PoseConfig(width=0.125, frame="heart"))
    posed.config = "frames"
    with pytest.raises(RacinesError, match="choose patients or beating"):
        report(regressor, posed)
    store = PatientsStore()
    store.table = store.table.drop_columns("heart_sway")
    store.manifest["source"] = "patients"
    with pytest.raises(RacinesError, match="lack heart_sway.*racines data build --source patients"):
        train_pose(store, config(), Run(tmp_path, 0, "cpu", progress=False))
