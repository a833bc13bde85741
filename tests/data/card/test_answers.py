"""What is said of recordings is so: unit and frame of poses, people, splits, what was measured."""

import json
import re
from pathlib import Path

import mlcroissant
import numpy as np
import pytest

from racines_data.build.dataset import DataConfig, build
from racines_data.card.answers import contents, relations, split_by, uses
from racines_data.card.columns import frame_note, frame_of
from racines_data.card.croissant import write_croissant
from racines_data.card.datasheet import rai_fields
from racines_data.card.markdown import write_card
from racines_data.manifest import config_manifest, read_manifest
from racines_data.sources.rotation.source import RotationSource
from racines_data.sources.tracked import TrackedSource
from tests.data.sources.rotation_folder import write_rotation
from tests.data.sources.table_folder import (
    COUNT,
    QUATERNIONS,
    ROBOT,
    changed,
    source,
    synthetic_folder,
)
from tests.data.sources.test_tracked import write_sequence

FORCES = dict(zip(("fx", "fy", "fz"), np.tile([[0.1], [0.2], [-3.0]], COUNT), strict=True))
WRENCH = {"columns": [*FORCES], "unit": "N"}


@pytest.fixture(scope="module")
def imported(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Turns without and with a scale, tables of a tracker and of a robot, a tracked sweep."""
    at = tmp_path_factory.mktemp("answers")
    turns = write_rotation(at / "turns")
    robot = changed(ROBOT, segments=5, forces=WRENCH)
    made = {
        "pixels": RotationSource.from_config({}, [turns]),
        "metres": RotationSource.from_config({"pixel_mm": 0.5, "split": "gap"}, [turns]),
        "tracker": source(synthetic_folder(at / "tracker"), changed(QUATERNIONS)),
        "robot": source(synthetic_folder(at / "robot", **FORCES), robot),
        "tracked": TrackedSource.from_config({}, [write_sequence(at / "a.igs.mha")]),
    }
    for name, each in made.items():
        build(each, at / "made" / name, DataConfig(source=each.name, workers=1))
    return {name: at / "made" / name for name in made}


def fields(root: Path) -> dict[str, str]:
    """Return the descriptions of the columns of `frames` in Croissant."""
    document = json.loads((root / "croissant.json").read_text())
    frames = next(each for each in document["recordSet"] if each["@id"] == "frames")
    return {field["name"]: field["description"] for field in frames["field"]}


def answer(root: Path, question: str) -> str:
    """Return the answer to a question of the datasheet."""
    found = re.search(
        rf"^\*\*{re.escape(question)}\*\* (.*)$", (root / "README.md").read_text(), re.M
    )
    assert found, question
    return found[1]


@pytest.mark.parametrize(
    ("name", "unit", "frame"),
    [
        ("pixels", "pixels", "frame of the file of poses"),
        ("metres", "m", "frame of the file of poses"),
        ("tracker", "m", "tracker's frame"),
        ("robot", "m", "robot base frame"),
        ("tracked", "m", "tracker's frame"),
    ],
)
def test_unit_and_frame_are_those_of_the_recordings(
    imported: dict[str, Path], name: str, unit: str, frame: str
):
    told, card = fields(imported[name]), (imported[name] / "README.md").read_text()
    assert told["position_x"] == f"Position x, {unit}, {frame}; nullable."
    assert told["rotation_y"].startswith(f"Rotation y, rad, {frame}")
    assert told["control_z"] == f"Commanded velocity z, {unit}/s, {frame}; null where unknown."
    assert told["control_rz"] == f"Commanded velocity rz, rad/s, {frame}; null where unknown."
    line = next(line for line in card.splitlines() if line.startswith("| `position_x`, "))
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    point = "marker on the probe" if name == "tracked" else "probe's tip"
    assert cells[2:] == [unit, f"{point}, {frame}"]
    assert ("SI units" in card) == (name != "pixels")
    assert ("obot base frame" in card) == (name == "robot")


def test_poses_that_are_not_there_have_no_frame(imported: dict[str, Path]):
    manifest = read_manifest(imported["robot"]) | {"source": "cactus", "poses": False}
    assert frame_note(manifest) == "No poses were recorded"
    assert "| null: no poses were recorded |" in write_card(manifest)


def test_patients_beside_recordings_are_in_the_robots_frame(imported: dict[str, Path]):
    manifest = read_manifest(imported["pixels"])
    manifest["patients"] = {"source": "patients", "card": None, "bounds": None}
    assert frame_of(manifest) == "frame of the file of poses"
    assert frame_of(config_manifest(manifest, "patients")) == "robot base frame"


@pytest.mark.parametrize("name", ["pixels", "metres", "tracker", "robot", "tracked"])
def test_nothing_is_claimed_of_recordings_that_is_a_phantoms(imported: dict[str, Path], name: str):
    root = imported[name]
    described = mlcroissant.Dataset(str(root / "croissant.json")).metadata
    assert not described.ctx.issues.errors
    told = rai_fields(read_manifest(root))
    impact = told["rai:dataSocialImpact"]
    assert "phantom" not in impact and "of other people it says nothing" in impact
    assert "leaderboard" not in told["rai:dataUseCases"][0]
    assert "Whoever imported it maintains it." in told["rai:dataReleaseMaintenancePlan"]
    people = answer(root, "Were people involved, and was there an ethical review?")
    assert "whoever imported the recordings answers for consent" in people
    assert "phantom" not in people
    kind = read_manifest(root)["source"]
    assert f"`racines data import`, source `{kind}`" in answer(root, "With what software?")
    assert answer(root, "Are the frames simulated, and by what model?").startswith("No")


def test_a_rotation_is_split_by_angle_and_has_no_forces(imported: dict[str, Path]):
    root = imported["pixels"]
    splits = answer(root, "Are there recommended splits?")
    assert "by angle of the turn" in splits and "narrow blocks" in splits
    assert "target view" not in splits and "stratified" not in (root / "README.md").read_text()
    assert "one wide block" in answer(imported["metres"], "Are there recommended splits?")
    consists = answer(root, "What does each consist of?")
    assert "the phase of the beat" in consists and "the angle of its turn" in consists
    assert consists.endswith("null: force, torque, view, grade.")
    purpose = answer(root, "For what purpose was it made?")
    assert "force" not in purpose and "grade" not in purpose
    assert "no action lies between" in answer(root, "Are relations between instances explicit?")
    assert "one heart only" in answer(root, "What could go wrong?")


def test_a_table_says_what_was_measured_and_that_it_was_cut(imported: dict[str, Path]):
    robot, tracker = imported["robot"], imported["tracker"]
    assert "the probe's pose, and force; and" in answer(robot, "What does each consist of?")
    assert "pose and force" in rai_fields(read_manifest(robot))["rai:dataUseCases"][0]
    assert "force" not in rai_fields(read_manifest(tracker))["rai:dataUseCases"][0]
    splits = answer(robot, "Are there recommended splits?")
    assert "parts of longer sweeps" in splits and "by trajectory. " in splits
    manifest = read_manifest(robot)
    manifest["recipe"]["settings"]["mapping"]["segments"] = 1
    assert "parts of longer sweeps" not in write_card(manifest)


def test_what_is_simulated_or_of_a_block_shows_no_person(tiny_root: Path):
    manifest = read_manifest(tiny_root)
    assert split_by(manifest) == "trajectory, stratified by target view"
    assert contents(manifest).startswith("the probe's pose, force, torque, the view it shows")
    assert "pose and force, view and grade classifiers, and scanning agents" in uses(manifest)
    assert "transition" in relations(manifest)
    people = answer(tiny_root, "Were people involved, and was there an ethical review?")
    assert people == "No: the frames are simulated, and no person was scanned."
    assert "do well on a simulation only" in rai_fields(manifest)["rai:dataSocialImpact"]
    block = rai_fields(manifest | {"source": "release"})["rai:dataSocialImpact"]
    assert "do well on a manufactured phantom only" in block
    assert "robot base frame" in write_croissant(manifest, tiny_root)


def test_splits_that_another_package_may_have_dealt_are_not_called_stratified(tiny_root: Path):
    assert split_by(read_manifest(tiny_root) | {"source": "theirs"}) == "trajectory"
