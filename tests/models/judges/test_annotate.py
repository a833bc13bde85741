"""A grader's opinion written into a dataset: complete, consistent, and not served stale."""

import dataclasses
import json
import shutil
from pathlib import Path

import datasets
import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from typer.testing import CliRunner

from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.manifest import read_manifest
from racines_data.schema import Trajectory
from racines_data.sources.base import Unit
from racines_data.store.frames import open_store
from racines_data.validate.run import validate
from racines_leaderboard.cli.command import app
from racines_models.judges.grader import annotate as module
from racines_models.judges.grader.annotate import annotate
from racines_models.judges.grader.model import Grader, GraderConfig, GraderNetwork
from tests.data.fake_source import FakeConfig, FakeSource

CONFIG = GraderConfig(input_size=32, width=0.125, bf16=False)
GRADED = ("view_predicted", "grade_predicted")


@pytest.fixture(autouse=True)
def own_caches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(datasets.config, "HF_DATASETS_CACHE", tmp_path / "cache" / "datasets")


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("made") / "racines"
    build(FakeSource(FakeConfig()), root, DataConfig(workers=1))
    return root


@pytest.fixture
def root(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "racines"))


def new_grader(folder: Path, seed: int) -> Grader:
    """A grader of random weights that tells random images apart."""
    torch.manual_seed(seed)
    grader = Grader(GraderNetwork(32, 0.125), CONFIG)
    features = grader.features(torch.randint(0, 256, (200, 128, 128), dtype=torch.uint8))
    mean, std = features.mean(0), features.std(0) + 1e-6
    head = grader.network.view_head
    head.weight.copy_(torch.randn(6, len(mean)) / std)
    head.bias.copy_(-head.weight @ mean)
    layers = grader.network.grade_head
    layers[0].weight.copy_(0.1 * torch.randn(128, len(mean)) / std)
    layers[0].bias.copy_(-layers[0].weight @ mean)
    layers[2].bias.fill_(0.5)
    grader.save(folder)
    return Grader.load(folder)


@pytest.fixture
def grader(tmp_path: Path) -> Grader:
    return new_grader(tmp_path / "grader", 0)


def rows(root: Path) -> list[dict]:
    names = read_manifest(root)["configs"]["frames"].values()
    return [
        row for split in names for name in split for row in pq.read_table(root / name).to_pylist()
    ]


def test_every_frame_gets_the_graders_view_and_grade(root: Path, grader: Grader):
    before, digest = rows(root), read_manifest(root)["digest"]
    manifest = annotate(root, grader)
    after = rows(root)
    view, grade, _ = grader.judge(open_store(root).images)
    assert [row["view_predicted"] for row in after] == view.tolist()
    assert len(set(view.tolist())) > 3 and grade.std() > 0.1
    found = torch.tensor([row["grade_predicted"] for row in after])
    assert torch.allclose(found, grade, atol=1e-5)
    for row in (*before, *after):
        for name in GRADED:
            row.pop(name)
    assert before == after and manifest["digest"] == digest == read_manifest(root)["digest"]
    assert manifest["annotation"]["grader"] == grader.sha256
    assert validate(root).ok
    assert not list(root.parent.glob(".racines*"))


def test_row_groups_and_other_files_stay(root: Path, made: Path, grader: Grader):
    annotate(root, grader)
    old, new = read_manifest(made)["files"], read_manifest(root)["files"]
    changed = {name for name in old if old[name] != new[name]}
    shards = {n for split in read_manifest(made)["configs"]["frames"].values() for n in split}
    assert changed == {*shards, "README.md", "croissant.json"} and set(old) == set(new)
    for name in shards:
        files = [pq.ParquetFile(folder / name) for folder in (made, root)]
        groups = [
            [f.metadata.row_group(i).num_rows for i in range(f.num_row_groups)] for f in files
        ]
        assert groups[0] == groups[1] and files[0].schema_arrow.equals(files[1].schema_arrow, True)


def test_readers_are_served_the_new_columns(root: Path, tmp_path: Path, grader: Grader):
    def served() -> list:
        return datasets.load_dataset(str(root), split="test")["grade_predicted"][:]

    assert set(served()) == {None}
    annotate(root, grader)
    first = served()
    assert None not in first
    annotate(root, new_grader(tmp_path / "other", 3))
    second = [row["grade_predicted"] for row in rows(root)][-len(first) :]
    assert served() == second != first


def test_into_another_folder(root: Path, tmp_path: Path, grader: Grader):
    out = tmp_path / "graded"
    annotate(root, grader, out)
    assert validate(out).ok and validate(root).ok
    assert "annotation" in read_manifest(out) and "annotation" not in read_manifest(root)
    store = "store/frames.arrow"
    assert (out / store).stat().st_ino != (root / store).stat().st_ino
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").touch()
    with pytest.raises(RacinesError, match="is not a dataset"):
        annotate(root, grader, tmp_path / "full")


class Killed(Exception):
    pass


@pytest.mark.parametrize("shards", [0, 5])
def test_a_killed_run_goes_on_and_leaves_the_old_dataset_till_then(
    root: Path, tmp_path: Path, grader: Grader, monkeypatch: pytest.MonkeyPatch, shards: int
):
    whole = tmp_path / "whole"
    annotate(root, grader, whole)
    save, judged = module.save_weights, []

    def until_killed(path, opinions):
        if len(judged) == 7:
            raise Killed
        judged.append(path.name)
        return save(path, opinions)

    def killed(*_):
        raise Killed

    with monkeypatch.context() as patch:
        if shards:
            patch.setattr(module, "save_weights", until_killed)
        else:
            patch.setattr(module, "swap_folder", killed)
        with pytest.raises(Killed):
            annotate(root, grader)
    assert validate(root).ok and "annotation" not in read_manifest(root)
    first = list(judged)
    judged.clear()
    monkeypatch.setattr(
        module, "save_weights", lambda *given: judged.append(given[0].name) or save(*given)
    )
    annotate(root, grader)
    assert not set(first) & set(judged) and bool(judged) == bool(shards)
    assert read_manifest(root) == read_manifest(whole)


def test_a_dataset_that_changes_meanwhile_is_left_as_it_is(
    root: Path, grader: Grader, monkeypatch: pytest.MonkeyPatch
):
    """Another config may have been added, which would be gone with the folder that is replaced."""
    path, seal = root / "manifest.json", module._seal
    changed = json.loads(path.read_text())
    changed["files"]["beating/train.parquet"] = {"sha256": "0" * 64, "bytes": 1}

    def meanwhile(*arguments):
        path.write_text(json.dumps(changed))
        return seal(*arguments)

    monkeypatch.setattr(module, "_seal", meanwhile)
    with pytest.raises(RacinesError, match="changed while it was annotated"):
        annotate(root, grader)
    assert json.loads(path.read_text()) == changed


def test_agreement_where_the_truth_is_known(root: Path, grader: Grader):
    told = annotate(root, grader)["annotation"]["agreement"]
    assert set(told) == {"train", "validation", "test"}
    store, view = open_store(root), np.array([row["view_predicted"] for row in rows(root)])
    test = store.split_indices("test").numpy()
    known = store.views.numpy()[test] >= 0
    right = (view[test] == store.views.numpy()[test])[known].mean()
    assert told["test"]["view_agreement"]["value"] == pytest.approx(right)
    assert told["test"]["view_agreement"]["n"] == known.sum()
    assert told["test"]["grade_error"]["unit"] == "grades of 10"


class Recordings(FakeSource):
    """Images without poses, times, views or grades."""

    name = "cactus"
    poses = False

    def produce(self, unit: Unit) -> Trajectory:
        made = super().produce(unit)
        unknown = {"views": np.full(len(made), -1), "grades": np.full(len(made), np.nan)}
        absent = {
            "parameters": np.full_like(made.parameters, np.nan),
            "timestamps": np.full(len(made), np.nan),
        }
        return dataclasses.replace(made, **unknown, **absent)


def test_frames_without_poses_or_labels(tmp_path: Path, grader: Grader):
    root = tmp_path / "images"
    build(Recordings(FakeConfig(frames=60, trajectories=6)), root, DataConfig(workers=1))
    annotation = annotate(root, grader)["annotation"]
    assert annotation["frames"] == 60 and annotation["agreement"] == {}
    result = validate(root)
    assert result.ok and "times" not in {check.name for check in result.checks}
    assert None not in [row["grade_predicted"] for row in rows(root)]


def test_what_cannot_be_annotated_is_refused(root: Path, tmp_path: Path, grader: Grader):
    with pytest.raises(RacinesError, match="no weights on disk"):
        annotate(root, Grader(GraderNetwork(32, 0.125), CONFIG))
    kidney = Grader(GraderNetwork(32, 0.125, 2), CONFIG, labels=("RK", "Random"))
    kidney.save(tmp_path / "kidney")
    with pytest.raises(RacinesError, match="the grader knows RK, Random, the dataset has A4C"):
        annotate(root, kidney)
    shard = root / read_manifest(root)["configs"]["frames"]["test"][0]
    content = bytearray(shard.read_bytes())
    content[3000] ^= 1
    shard.write_bytes(bytes(content))
    with pytest.raises(RacinesError, match="sha256 differs"):
        annotate(root, grader)


def test_rows_in_another_order_than_the_store_are_refused(root: Path, grader: Grader):
    names = read_manifest(root)["configs"]["frames"]["test"]
    manifest = read_manifest(root)
    manifest["configs"]["frames"]["test"] = names[::-1]
    (root / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(RacinesError, match="are not those of the training store"):
        annotate(root, grader)


def test_command(root: Path, tmp_path: Path, grader: Grader):
    run = CliRunner().invoke
    words = ["data", "annotate", str(root), "--grader", str(tmp_path / "grader")]
    done = run(app, [*words, "--json"])
    assert done.exit_code == 0, done.exception
    told = json.loads(done.stdout)
    assert told["grader"] == grader.sha256 and told["frames"] == 200
    again = run(app, words).stdout
    assert "grader and labels, test split" in again and "200 frames annotated" in again
    assert run(app, ["data", "validate", str(root)]).exit_code == 0
    done = run(app, ["data", "annotate", str(root), "--grader", str(tmp_path)])
    assert "racines train grader" in str(done.exception)
