"""What judges of simulated patients say of an imported set: recognised, alike, motion read."""

import json

import numpy as np
import pytest
import torch
from torch import Tensor
from typer.testing import CliRunner

from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.geometry import Pose, parameters_to_pose
from racines_data.sources.rotation.source import RotationSource
from racines_data.store.frames import open_store
from racines_leaderboard.cli.command import app
from racines_models.protocol import Judge
from racines_models.studies.sim_to_real import imported
from racines_models.studies.sim_to_real.imported import FEWEST, MOVED, measure_imported
from racines_models.studies.sim_to_real.imported_sheet import sheet, told_rows
from tests.data.sources.rotation_folder import PHASES, TURNS, write_rotation


class Knows(Judge):
    """Calls every image by a list, in turn."""

    labels = ("A4C", "SC", "PL", "PSAV", "PSMV", "Random")
    settings = {"sha256": "0" * 64}  # noqa: RUF012

    def __init__(self, answers: Tensor) -> None:
        self.answers = answers

    def probabilities_and_grade(self, images: Tensor) -> tuple[Tensor, Tensor]:
        now, self.answers = self.answers[: len(images)], self.answers[len(images) :]
        return torch.nn.functional.one_hot(now, 6).float(), torch.full((len(images),), 5.0)


class Reads:
    """Reads the recorded poses, in a frame of its own, each with the same error of scale."""

    settings = {"sha256": "1" * 64}  # noqa: RUF012

    def __init__(self, pose: Pose) -> None:
        self.pose = pose

    def predict(self, images: Tensor) -> Pose:
        assert len(images) == len(self.pose.position)
        turned = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        return Pose(2.0 * self.pose.position @ turned.T, turned @ self.pose.rotation)


@pytest.fixture
def store(tiny_root, monkeypatch):
    monkeypatch.setattr(imported, "FRAMES", 10_000)
    return open_store(tiny_root)


def test_views_are_counted_by_the_labels_of_the_set(store):
    true = store.views.clamp_min(0)
    wrong = true.clone()
    wrong[(true == 5).nonzero()[::2, 0]] = 0
    told = measure_imported(store, Knows(wrong)).content["recognised"]
    assert sum(told["called"].values()) == len(store.images)
    for name, figure in told["views"].items():
        rows = store.views == store.labels.index(name)
        assert figure["n"] == int(rows.sum()) >= FEWEST
        share = float((wrong[rows] == true[rows]).double().mean())
        assert figure["value"] == pytest.approx(share)
    assert told["views"]["Random"]["value"] < 0.6


def test_motion_is_held_to_the_recorded_one(store):
    pose = parameters_to_pose(store.parameters)
    told = measure_imported(store, pose=Reads(pose)).content["motion"]
    assert told["pairs"] > FEWEST
    angle, shift = told["angle_deg"], told["shift_mm"]
    assert angle["true_median"] >= MOVED and angle["error_median"] < 0.05
    assert angle["correlation"] > 0.999 and shift["correlation"] > 0.999
    assert shift["read_median"] == pytest.approx(2.0 * shift["true_median"], rel=1e-3)


def test_a_set_of_unknown_scale_tells_no_millimetres(store):
    store.manifest = store.manifest | {"scale": "unknown"}
    pose = parameters_to_pose(store.parameters)
    told = measure_imported(store, pose=Reads(pose)).content["motion"]
    assert "shift_mm" not in told and told["angle_deg"]["correlation"] > 0.999


def test_turns_are_paired_with_one_another_at_one_phase(tmp_path, monkeypatch):
    """Each turn is a trajectory of one pose, in which nothing moves but the heart."""
    source = RotationSource.from_config({}, [write_rotation(tmp_path / "in")])
    build(source, tmp_path / "turns", DataConfig(workers=1, shards=1))
    store = open_store(tmp_path / "turns")
    asked = []

    def pairs(pose, known, group):
        asked.extend([group, found := by_group(pose, known, group)])
        return found

    by_group = imported._pairs
    monkeypatch.setattr(imported, "_pairs", pairs)
    told = measure_imported(store, pose=Reads(parameters_to_pose(store.parameters)))
    group, (first, second) = asked
    assert len(group.unique()) == PHASES and torch.equal(group[first], group[second])
    assert torch.equal(store.phases[first, 0], store.phases[second, 0])
    assert (store.trajectory_index[first] != store.trajectory_index[second]).all()
    motion = told.content["motion"]
    assert motion["pairs"] == len(first) > TURNS * PHASES / 2 and "turns" in motion["paired"]
    assert motion["angle_deg"]["correlation"] > 0.999 and "shift_mm" not in motion


def test_a_sheet_and_rows_tell_it(store):
    measured = measure_imported(store, Knows(store.views.clamp_min(0)))
    assert sheet(measured).startswith(b"\x89PNG")
    rows = dict(told_rows(measured.content))
    assert rows["Random called Random"].startswith("100%")
    assert "KID to simulated A4C" not in rows
    with pytest.raises(RacinesError, match="no judge"):
        measure_imported(store)


def test_the_command_takes_a_dataset(tiny_root, tmp_path, monkeypatch):
    asked = []

    def measure(store, grader, pose, extractor):
        asked.append((len(store.images), grader, pose.settings["sha256"]))
        return measure_imported(store, Knows(store.views.clamp_min(0)))

    monkeypatch.setattr(imported, "measure_imported", measure)
    words = ["study", "sim-to-real", "--real", str(tiny_root), "--no-grader", "--json"]
    done = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "told")])
    assert done.exit_code == 0, done.output
    assert asked[0][1] is None and json.loads(done.stdout)["frames"] == min(512, asked[0][0])
    assert {path.name for path in tmp_path.iterdir()} == {"told.json", "told.png"}
    assert np.isfinite(json.loads((tmp_path / "told.json").read_text())["seconds"])
