"""Croissant metadata: valid for the real library, and rows really come out of it."""

import hashlib
import json
from pathlib import Path

import mlcroissant
import numpy as np
import pytest

import racines_data
from racines_data.build.dataset import DataConfig, build
from racines_data.schema import PARAMETERS
from racines_data.sources.base import NOT_TOLD, PROJECT
from racines_data.sources.rotation.source import RotationSource
from tests.data.fake_source import FakeConfig, FakeSource
from tests.data.sources.rotation_folder import PHASES, TURNS, write_rotation
from tests.data.sources.table_folder import COUNT, ROBOT, changed, source, synthetic_folder

RAI = ("dataCollection", "dataBiases", "dataLimitations", "dataUseCases", "dataSocialImpact")
RAI_MORE = ("personalSensitiveInformation", "dataReleaseMaintenancePlan", "dataAnnotationProtocol")


@pytest.fixture(scope="module")
def described(built: Path) -> mlcroissant.Dataset:
    return mlcroissant.Dataset(str(built / "croissant.json"))


def test_it_is_valid(described: mlcroissant.Dataset):
    issues = described.metadata.ctx.issues
    assert not issues.errors
    # A build does not know the day on which somebody will publish it.
    assert all("datePublished" in warning for warning in issues.warnings)


def test_responsible_ai_fields_are_read_back(described: mlcroissant.Dataset, built: Path):
    document = json.loads((built / "croissant.json").read_text())
    assert "http://mlcommons.org/croissant/RAI/1.0" in document["conformsTo"]
    assert all(document[f"rai:{name}"] for name in (*RAI, *RAI_MORE))
    assert "Simulated" in (described.metadata.data_collection or "")
    assert "near-copies" in described.metadata.data_limitations[0]
    assert "not a medical device" in described.metadata.data_use_cases[0]


def test_files_have_sha256_and_size(built: Path):
    document = json.loads((built / "croissant.json").read_text())
    objects = [each for each in document["distribution"] if each["@type"] == "cr:FileObject"]
    shards = {path.relative_to(built).as_posix() for path in built.glob("data/*/*.parquet")}
    assert {each["contentUrl"] for each in objects} == shards
    for each in objects:
        content = (built / each["contentUrl"]).read_bytes()
        assert each["sha256"] == hashlib.sha256(content).hexdigest()
        assert each["contentSize"] == f"{len(content)} B"


def test_file_sets_name_each_config_and_split(built: Path):
    document = json.loads((built / "croissant.json").read_text())
    sets = {e["name"]: e["includes"] for e in document["distribution"] if "includes" in e}
    configs = json.loads((built / "manifest.json").read_text())["configs"]
    for config, splits in configs.items():
        for split, paths in splits.items():
            assert sets[f"files/{config}-{split}"] == paths
        assert sets[f"files/{config}"] == [path for paths in splits.values() for path in paths]
    assert {"frames", "sessions", "trajectories"} <= set(configs)


def test_records_are_the_rows_of_the_dataset(described: mlcroissant.Dataset, built: Path):
    rows = {}
    for row in described.records("frames"):
        rows[row["frames/trajectory"].decode(), int(row["frames/frame"])] = row
    assert len(rows) == 200
    loaded = racines_data.load(root=built)
    for split, part in loaded.items():
        for expected in list(part)[:5]:
            row = rows[expected["trajectory"], expected["frame"]]
            assert row["frames/split"] == split.encode()
            assert np.array_equal(row["frames/image"], expected["image"])
            assert all(row[f"frames/{name}"] == expected[name] for name in PARAMETERS)
            assert row["frames/view"] == expected["view"]
            assert row["frames/grade"] == expected["grade"]


def test_one_split_can_be_asked_for(built: Path):
    described = mlcroissant.Dataset(str(built / "croissant.json"))
    rows = list(described.records("frames", filters={"frames/split": "test"}))
    assert len(rows) == 50 and {row["frames/split"] for row in rows} == {b"test"}


def test_trajectories_and_splits_are_records_too(described: mlcroissant.Dataset):
    sweeps = list(described.records("trajectories"))
    assert len(sweeps) == 20 and sum(row["trajectories/frames"] for row in sweeps) == 200
    names = [row["splits/name"] for row in described.records("splits")]
    assert names == ["train", "validation", "test"]


def test_units_and_labels_stand_in_the_descriptions(built: Path):
    document = json.loads((built / "croissant.json").read_text())
    frames = next(each for each in document["recordSet"] if each["@id"] == "frames")
    told = {field["name"]: field["description"] for field in frames["field"]}
    assert (
        ", N, " in told["force_z"] and "N·m" in told["torque_x"] and ", m, " in told["position_x"]
    )
    assert "rad" in told["rotation_y"] and "rad/s" in told["control_rx"]
    assert "A4C, SC, PL, PSAV, PSMV, Random" in told["view"]


def test_the_manifest_seals_it_and_builds_agree(built: Path, tmp_path: Path):
    record = json.loads((built / "manifest.json").read_text())["files"]["croissant.json"]
    content = (built / "croissant.json").read_bytes()
    assert record == {"sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content)}
    build(FakeSource(FakeConfig()), tmp_path / "again", DataConfig(workers=1))
    assert (tmp_path / "again" / "croissant.json").read_bytes() == content


@pytest.mark.parametrize("kind", ["rotation", "table"])
@pytest.mark.parametrize("origin", ["A. Doe, B. Roe, https://x.org/a", ""])
def test_an_imported_set_is_valid_and_credits_its_makers(kind: str, origin: str, tmp_path: Path):
    """Never this project, which has made none of it; its name stands on what it simulates."""
    said = DataConfig(source=kind, workers=1, licence="MIT", consent="written", origin=origin)
    if kind == "rotation":
        made, frames = (
            RotationSource.from_config({}, [write_rotation(tmp_path / "in")]),
            TURNS * PHASES,
        )
    else:
        made, frames = source(synthetic_folder(tmp_path / "in"), changed(ROBOT, segments=5)), COUNT
    build(made, tmp_path / "out", said)
    described = mlcroissant.Dataset(str(tmp_path / "out" / "croissant.json"))
    assert not described.metadata.ctx.issues.errors
    assert all("datePublished" in each for each in described.metadata.ctx.issues.warnings)
    (creator,) = described.metadata.creators
    name, url = ("A. Doe, B. Roe", "https://x.org/a") if origin else (NOT_TOLD, None)
    assert (creator.name, creator.url) == (name, url)
    cited = described.metadata.cite_as or ""
    assert f"author = {{{{{name}}}}}" in cited and "recordings imported by RACINES" in cited
    assert (
        f"Origin, as declared at import: {origin}" in described.metadata.data_collection
        or not origin
    )
    assert "developers" not in (tmp_path / "out" / "croissant.json").read_text()
    assert len(list(described.records("frames"))) == frames


def test_what_is_simulated_has_the_projects_name(tiny_root: Path):
    document = json.loads((tiny_root / "croissant.json").read_text())
    assert document["creator"] == {"@type": "sc:Organization", "name": PROJECT}
    assert document["citeAs"].startswith(
        "@misc{racines-phantom, author = {{The RACINES developers}}, title = {RACINES, phantom "
    )
