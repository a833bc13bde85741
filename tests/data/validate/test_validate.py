import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image
from typer.testing import CliRunner

from racines_data import RacinesError
from racines_data.build.dataset import DataConfig, build
from racines_data.card.markdown import write_card
from racines_data.files import sha256_file
from racines_data.manifest import read_manifest
from racines_data.schema import Trajectory
from racines_data.sources.base import Unit
from racines_data.validate import survey as validate_survey
from racines_data.validate.canonical import LEVELS
from racines_data.validate.run import Check, validate
from racines_leaderboard.cli.command import app
from tests.data.fake_source import FakeConfig, FakeSource


@pytest.fixture
def copy(built: Path, tmp_path: Path) -> Path:
    shutil.copytree(built, tmp_path / "racines")
    return tmp_path / "racines"


class FakeHearts(FakeSource):
    """Sessions are hearts."""

    def produce(self, unit: Unit) -> Trajectory:
        made = super().produce(unit)
        return dataclasses.replace(made, phantom=int(unit.session[1:]) + 1)


def broken(root: Path) -> dict[str, str]:
    return {
        check.name: check.detail
        for check in validate(root).checks
        if check.binding and not check.ok
    }


def reseal(root: Path, **changes) -> None:
    """Write a manifest that fits the files as they are: only deeper checks can object."""
    manifest = read_manifest(root) | changes
    for name, record in manifest["files"].items():
        record |= {"sha256": sha256_file(root / name), "bytes": (root / name).stat().st_size}
    (root / "manifest.json").write_text(json.dumps(manifest))


def alter(root: Path, name: str, change, split: str = "test") -> None:
    """Put a changed column into the first shard of a split, and seal it again."""
    shard = root / read_manifest(root)["configs"]["frames"][split][0]
    table = pq.read_table(shard)
    index = table.schema.get_field_index(name)
    column = pa.array(change(table[name].to_pylist()), table.schema.field(index).type)
    pq.write_table(table.set_column(index, table.schema.field(index), column), shard)
    reseal(root)


def test_a_good_dataset_has_no_faults_and_twelve_statistics(built: Path):
    result = validate(built)
    assert result.ok and len(result.statistics) == 12
    names = [check.name for check in result.checks]
    assert names == [
        *("files", "card", "recipe", "rows", "counts", "content", "splits", "store", "times"),
        *("rate", "labels", "views", "annotation", "copies", "near-copies", "oracle"),
        *("leaks", "paper's table", "rotation_x"),
    ]
    assert abs(result.statistics["position_x"].mean - 0.49) < 0.03
    assert 0.08 < result.statistics["position_x"].std < 0.12


def test_altered_bytes(copy: Path):
    shard = copy / read_manifest(copy)["configs"]["frames"]["train"][0]
    content = bytearray(shard.read_bytes())
    content[3000] ^= 1
    shard.write_bytes(bytes(content))
    assert "sha256 differs" in broken(copy)["files"]


def test_a_file_that_is_not_sealed(copy: Path):
    manifest = read_manifest(copy)
    name = manifest["configs"]["frames"]["train"][0]
    del manifest["files"][name]
    (copy / "manifest.json").write_text(json.dumps(manifest))
    assert f"{name} of config frames is not among" in broken(copy)["files"]


def test_altered_rows_under_a_new_seal(copy: Path):
    alter(copy, "position_x", lambda values: [0.5] * len(values))
    assert {"content", "splits", "store"} <= set(broken(copy))
    assert "content digest" in broken(copy)["content"]
    assert "disagree on" in broken(copy)["splits"]
    assert "differs between store and shards" in broken(copy)["store"]


def test_a_trajectory_in_two_splits(copy: Path):
    configs = read_manifest(copy)["configs"]
    train, test = (copy / configs["frames"][split][0] for split in ("train", "test"))
    shutil.copy(train, test)
    reseal(copy)
    faults = broken(copy)
    assert "is in test and in train" in faults["splits"]
    assert "copies of training frames" in faults["copies"]


def test_sessions_that_share_the_one_held_out(copy: Path):
    manifest = read_manifest(copy)
    configs = manifest["configs"]
    configs["sessions"]["test"].append(configs["sessions"]["train"].pop())
    reseal(copy, configs=configs)
    (copy / "README.md").write_text(write_card(read_manifest(copy)))
    reseal(copy)
    assert set(broken(copy)) == {"splits"}
    assert "where s1 is the one held out" in broken(copy)["splits"]


def test_another_schema(copy: Path):
    shard = copy / read_manifest(copy)["configs"]["frames"]["test"][0]
    pq.write_table(pq.read_table(shard).drop_columns("grade"), shard)
    reseal(copy)
    assert "columns differ from the schema" in broken(copy)["rows"]


def test_an_image_that_cannot_be_read(copy: Path):
    def cut(values):
        return [{**values[0], "bytes": values[0]["bytes"][:60]}, *values[1:]]

    alter(copy, "image", cut)
    assert "its rows cannot be read" in broken(copy)["rows"]


def test_out_of_range(copy: Path):
    alter(copy, "position_z", lambda values: [60.2] * len(values))
    assert "lies 60.2 m from the origin, beyond 2" in broken(copy)["rows"]


def test_frame_numbers_out_of_order(copy: Path):
    alter(copy, "frame", lambda values: [1, 0, *values[2:]])
    assert "frame numbers are not 0 to 9 in order" in broken(copy)["rows"]


def test_clocks_that_stand_still_or_waver(copy: Path):
    alter(copy, "timestamp", lambda values: [values[0], values[0], *values[2:]])
    assert "time does not go on after frame 0" in broken(copy)["times"]
    assert "s after frame" in broken(copy)["rate"]


@pytest.mark.parametrize(
    ("view", "grade", "reason"),
    [
        (5, 3.0, "is Random, yet graded"),
        (0, 0.5, "of a view, graded outside 1-10"),
        (None, 4.0, "graded, of unknown view"),
    ],
)
def test_grades_that_do_not_go_with_the_view(copy: Path, view, grade, reason):
    alter(copy, "view", lambda values: [*values[:4], view, *values[5:]])
    alter(copy, "grade", lambda values: [*values[:4], grade, *values[5:]])
    assert "frame 4" in broken(copy)["labels"] and reason in broken(copy)["labels"]


def test_a_target_that_is_no_label(copy: Path):
    def rename(values):
        return ["XYZ" if value == values[0] else value for value in values]

    alter(copy, "target_view", rename)
    faults = broken(copy)
    assert "target view 'XYZ' is none of A4C" in faults["labels"]
    assert "unknown target view 'XYZ'" in faults["rows"]


def test_opinions_of_no_recorded_grader_or_of_one_that_left_frames_out(copy: Path):
    alter(copy, "view_predicted", lambda values: [1, *values[1:]])
    assert "not there together" in broken(copy)["annotation"]
    alter(copy, "grade_predicted", lambda values: [5.0, *values[1:]])
    assert "1 frames are annotated, by no recorded grader" in broken(copy)["annotation"]
    reseal(copy, annotation={"grader": "0" * 64})
    assert "frames lack the grader's opinion" in broken(copy)["annotation"]


def test_wrong_counts_and_recipe(copy: Path):
    manifest = read_manifest(copy)
    manifest["counts"]["splits"]["train"]["frames"] += 1
    reseal(copy, counts=manifest["counts"], recipe={**manifest["recipe"], "format": 99})
    assert set(broken(copy)) == {"counts", "recipe"}


def test_card_of_another_dataset(copy: Path):
    card = copy / "README.md"
    text = card.read_text()
    card.write_text(text.replace(read_manifest(copy)["digest"], "0" * 64))
    reseal(copy)
    assert "describes another dataset" in broken(copy)["card"]
    manifest = read_manifest(copy)
    name = manifest["configs"]["frames"]["test"][0]
    card.write_text(text.replace(f"- {name}", f"- {name}x"))
    reseal(copy)
    assert "names other configs, splits or files" in broken(copy)["card"]


@pytest.mark.usefixtures("warm_workers")
def test_worker_processes_find_the_same(copy: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(validate_survey, "WORTH_WORKERS", 1)
    alter(copy, "position_z", lambda values: [60.2, *values[1:]])
    alone, together = validate(copy), validate(copy, workers=2)
    assert alone.checks == together.checks and not alone.ok
    assert alone.statistics == together.statistics


def test_many_hearts_are_split_by_heart(tmp_path: Path):
    root = tmp_path / "racines"
    many = FakeHearts(FakeConfig(frames=60, trajectories=12, sessions=6, seed=7))
    build(FakeSource(FakeConfig()), root, DataConfig(workers=1), many=many)
    result = validate(root)
    assert result.ok, broken(root)
    checks = {check.name: check.detail for check in result.checks}
    assert checks["multi_phantom, splits"] == "6 hearts, each in one split"
    configs = read_manifest(root)["configs"]["multi_phantom"]
    shutil.copy(root / configs["train"][0], root / configs["test"][0])
    reseal(root)
    faults = broken(root)
    assert "is in test and in train" in faults["multi_phantom, splits"]
    assert "copies of training frames" in faults["multi_phantom, copies"]
    assert "content digest" in faults["multi_phantom, content"]
    assert not {"splits", "content", "copies"} & set(faults)


def alter_canonical(root: Path, levels: int) -> None:
    path = root / "canonical" / "SC.png"
    image = np.asarray(Image.open(path)).astype(int)
    image[5, 5] += levels if image[5, 5] < 128 else -levels
    Image.fromarray(image.astype(np.uint8)).save(path)
    reseal(root, digest="0" * 64)


def test_the_same_version_on_another_processor(built: Path, copy: Path):
    def verdict() -> Check:
        return validate(built, against=copy).checks[-1]

    assert verdict() == Check("same version", True, "equal, byte for byte")
    alter_canonical(copy, 20)  # as measured between processors
    assert verdict().ok and "by 20 gray levels at most, 1 of" in verdict().detail
    shutil.copy(built / "canonical/SC.png", copy / "canonical")
    alter_canonical(copy, LEVELS + 1)
    assert not verdict().ok and "canonical frames differ" in verdict().detail
    reseal(copy, recipe_digest="1" * 64)
    assert not verdict().ok and "recipe_digest is" in verdict().detail


def test_command(built: Path, copy: Path):
    run = CliRunner().invoke
    done = run(app, ["data", "validate", str(built)])
    assert done.exit_code == 0 and "BROKEN" not in done.output
    assert "position_x" in done.output and "0.4886" in done.output
    report = json.loads(run(app, ["data", "validate", str(built), "--json"]).output)
    assert report["ok"] and report["statistics"]["force_z"]["paper"]["mean"] == -9.4422
    (copy / "canonical" / "SC.png").unlink()
    done = run(app, ["data", "validate", str(copy)])
    assert done.exit_code == 1 and "canonical/SC.png is missing" in done.output
    assert isinstance(run(app, ["data", "validate", str(copy / "none")]).exception, RacinesError)


def test_build_command_refuses_bad_requests(tmp_path: Path):
    params = tmp_path / "params.yaml"
    params.write_text("data: {frames: 10, workers: 1}\n")
    options = ["data", "build", "--params", str(params), "--out", str(tmp_path / "out")]

    def refusal(*words: str) -> str:
        return str(CliRunner().invoke(app, [*options, *words]).exception)

    assert "unknown source 'nothing'" in refusal("--source", "nothing")
    assert "name its files" in refusal("--source", "tracked")
    assert "--frames: source tracked has" in refusal("--source", "tracked", "--frames", "5")
    params.write_text("data: {framse: 10}\n")
    assert "data.framse: unknown key" in refusal()
    assert CliRunner().invoke(app, ["data", "build", "--no-such"]).exit_code == 2


def test_build_command(tmp_path: Path):
    params = tmp_path / "params.yaml"
    source = "tests.data.fake_source:FakeSource"
    params.write_text(f"data: {{source: '{source}', frames: 30, workers: 1, seed: 4}}\n")
    options = ["data", "build", "--params", str(params), "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, [*options, "--json"])
    assert done.exit_code == 0, done.exception
    figures = json.loads(done.stdout)
    assert figures["counts"]["frames"] == 30 and len(figures["digest"]) == 64
    again = CliRunner().invoke(app, options)
    assert figures["digest"] in again.output
