import json
import os
import shutil
from pathlib import Path

import datasets
import numpy as np
import pytest
import torch

from racines_data import RacinesError, open_store
from racines_data.build.dataset import DataConfig, build
from racines_data.export.registry import load_exporter
from racines_data.geometry import geodesic, parameters_to_pose
from racines_data.manifest import read_manifest
from racines_data.sources.base import PROJECT
from racines_data.sources.release.layout import RIGHTS
from racines_data.sources.release.source import ReleaseSource
from racines_data.store.frames import FrameStore
from tests.data.release_tree import read_elsewhere
from tests.data.scan_source import ScanConfig, ScanSource

FRAMES = 630


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("original") / "racines"
    config = ScanConfig(frames=FRAMES, trajectories=42, sessions=3)
    build(ScanSource(config), root, DataConfig(workers=1))
    return root


@pytest.fixture(scope="module")
def tree(original: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("exported") / "tree"
    result = load_exporter("release")(original, out)
    assert (result["frames"], result["trajectories"]) == (FRAMES, 42)
    assert result["sessions"]["session-2"] == "Folder 2" and result["notes"] == []
    return out


def in_order(store: FrameStore) -> torch.Tensor:
    """Return the rows in order of their pixels: the two datasets have other trajectory names."""
    pixels = [image.tobytes() for image in store.images.numpy()]
    return torch.tensor(sorted(range(len(pixels)), key=pixels.__getitem__))


def test_a_round_trip_keeps_images_and_poses(original: Path, tree: Path, tmp_path: Path):
    source = ReleaseSource.from_config({}, [tree])
    back = tmp_path / "back"
    build(source, back, DataConfig(workers=1))
    assert source.report == []
    one, two = open_store(original), open_store(back)
    assert len(one) == len(two) == FRAMES
    a, b = one.take(in_order(one)), two.take(in_order(two))
    assert torch.equal(a.images, b.images)
    before, after = (parameters_to_pose(batch.parameters.double()) for batch in (a, b))
    assert float((before.position - after.position).abs().max()) < 1e-6
    assert float((before.rotation - after.rotation).abs().max()) < 1e-6
    assert float(geodesic(before.rotation, after.rotation).max()) < 1e-6
    assert torch.allclose(a.parameters[:, :6], b.parameters[:, :6], atol=1e-6, rtol=1e-6)
    rows = in_order(one), in_order(two)
    assert torch.equal(one.timestamps[rows[0]], two.timestamps[rows[1]])
    assert torch.allclose(one.controls[rows[0]], two.controls[rows[1]], atol=1e-8)
    targets = [
        [store.target_views[int(i)] for i in store.trajectory_index[order]]
        for store, order in zip((one, two), rows, strict=True)
    ]
    assert targets[0] == targets[1]


def test_the_rights_go_with_the_tree_and_are_passed_over(original: Path, tree: Path):
    lines = dict(line.split(": ", 1) for line in (tree / RIGHTS).read_text().splitlines())
    assert lines["Licence"] == "cc-by-4.0. CC BY 4.0." and lines["Made by"] == PROJECT
    assert lines["Consent"] == "None: simulated; there is no subject."
    assert lines["Origin"].startswith("simulated ultrasound of the RACINES phantom")
    assert read_manifest(original)["digest"] in lines["Dataset"]
    source = ReleaseSource.from_config({}, [tree])
    assert sum(unit.frames for unit in source.plan()) == FRAMES and source.report == []


def test_only_the_rights_are_passed_over(tree: Path, tmp_path: Path):
    copy = tmp_path / "tree"
    shutil.copytree(tree, copy)
    for place in ("NOTES.txt", f"Folder 1/{RIGHTS}"):
        (copy / place).write_text("mine")
    source = ReleaseSource.from_config({}, [copy])
    source.plan()
    flagged = [finding.reason for finding in source.report]
    assert len(flagged) == 2 and "NOTES.txt" in flagged[0] and RIGHTS in flagged[1]


def test_a_line_break_in_a_statement_begins_no_line_of_the_rights(tmp_path: Path):
    root = tmp_path / "racines"
    source = ScanSource(ScanConfig(frames=24))
    build(source, root, DataConfig(workers=1))
    manifest = read_manifest(root)
    manifest["card"] = {"rights": "Ask.\nLicence: none needed", "license": "other"}
    (root / "manifest.json").write_text(json.dumps(manifest))
    load_exporter("release")(root, tmp_path / "tree")
    lines = (tmp_path / "tree" / RIGHTS).read_text().splitlines()
    assert [line for line in lines if line.startswith("Licence")] == [
        "Licence: other. Ask. Licence: none needed"
    ]


def test_pngs_are_the_shards_own_bytes(original: Path, tree: Path):
    shards = datasets.load_dataset(str(original)).cast_column("image", datasets.Image(decode=False))
    ours = {row["image"]["bytes"] for part in shards.values() for row in part}
    assert {path.read_bytes() for path in tree.rglob("*.png")} == ours and len(ours) == FRAMES


def test_a_reader_that_knows_only_the_layout_can_load_it(original: Path, tree: Path):
    frames = read_elsewhere(tree)
    store = open_store(original)
    assert len(frames) == FRAMES
    by_image = {frame["image"].tobytes(): frame for frame in frames}
    position, rotation = parameters_to_pose(store.parameters.double())
    for row in range(FRAMES):
        frame = by_image[store.images[row].numpy().tobytes()]
        trajectory = int(store.trajectory_index[row])
        view = store.target_views[trajectory].replace("Random", "Full")
        assert frame["session"] == store.sessions[trajectory].replace("session-", "Folder ")
        assert frame["view"] == view and frame["number"] == int(store.frame[row])
        assert np.abs(frame["pose"][:3, 3] - position[row].numpy()).max() < 1e-7
        assert np.abs(frame["pose"][:3, :3] - rotation[row].numpy()).max() < 1e-7
        assert np.array_equal(frame["pose"][3], [0, 0, 0, 1])
        assert np.abs(frame["wrench"] - store.parameters[row, :6].numpy()).max() < 1e-6
        assert np.abs(frame["control"] - store.controls[row].numpy()).max() < 1e-7
        assert frame["time"] == float(store.timestamps[row])


def test_the_layout(tree: Path):
    folders = {path.relative_to(tree).as_posix() for path in tree.glob("Folder 1/*/*")}
    sides = [f"{side}_{number}" for side in ("images", "logs") for number in range(1, 8)]
    assert folders == {f"Folder 1/{view}/{side}" for view in ("A4C", "PSAV") for side in sides}
    top = {"Folder 1", "Folder 2", "Folder 3", RIGHTS}
    assert {path.name for path in tree.iterdir()} == top
    names = {path.name for path in tree.glob("*/*/images*/*")}
    assert {name[:3] for name in names} == {"img"} and "img0.png" in names
    hidden = [path for path in tree.rglob(".*")]
    assert hidden == [] and len(list(tree.rglob("*"))) > 2 * FRAMES


def test_a_lone_trajectory_has_plain_folders(tmp_path: Path):
    root = tmp_path / "racines"
    source = ScanSource(ScanConfig(frames=30, trajectories=6, sessions=1))
    build(source, root, DataConfig(workers=1))
    load_exporter("release")(root, tmp_path / "tree")
    folders = {
        path.relative_to(tmp_path / "tree").as_posix() for path in tmp_path.glob("tree/*/*/*")
    }
    views = ("A4C", "SC", "PL", "PSAV", "PSMV", "Full")
    assert folders == {f"Folder 1/{v}/{side}" for v in views for side in ("images", "logs")}


def test_split_and_limit(original: Path, tmp_path: Path):
    export = load_exporter("release")
    store = open_store(original)
    result = export(original, tmp_path / "test", split="test")
    assert result["frames"] == len(store.split_indices("test"))
    result = export(original, tmp_path / "few", limit=70)
    assert result["frames"] == 70 == len(read_elsewhere(tmp_path / "few"))
    names = [store.trajectories[int(i)] for i in store.trajectory_index[:70].unique()]
    assert result["trajectories"] == len(names)
    with pytest.raises(RacinesError, match="unknown split 'dev'"):
        export(original, tmp_path / "x", split="dev")
    with pytest.raises(RacinesError, match="limit 0: nothing to export"):
        export(original, tmp_path / "x", limit=0)
    with pytest.raises(RacinesError, match="few: exists; name a new folder"):
        export(original, tmp_path / "few")


def test_more_sessions_than_known_folders_are_noted(tmp_path: Path):
    root = tmp_path / "racines"
    build(ScanSource(ScanConfig(trajectories=12, sessions=12)), root, DataConfig(workers=1))
    result = load_exporter("release")(root, tmp_path / "tree")
    assert result["sessions"]["session-10"] == "Folder 10"
    assert "only `Folder 1` to `Folder 3`" in result["notes"][0]


def test_absent_forces_are_written_as_nan(tmp_path: Path):
    root = tmp_path / "racines"
    build(ScanSource(ScanConfig(frames=24, forces=False)), root, DataConfig(workers=1))
    load_exporter("release")(root, tmp_path / "tree")
    assert np.isnan(read_elsewhere(tmp_path / "tree")[0]["wrench"]).all()
    source = ReleaseSource.from_config({"allow_absent": True}, [tmp_path / "tree"])
    assert sum(unit.frames for unit in source.plan()) == 24 and source.report == []


def test_a_stopped_export_goes_on(original: Path, tree: Path, tmp_path: Path, monkeypatch):
    from racines_data.export import release

    wrote: list[int] = []
    write = release._write_sweep

    def stops(staging, sweep, table):
        if len(wrote) == 10:
            (staging / sweep.folder / f".images{sweep.suffix}").mkdir(parents=True)
            raise KeyboardInterrupt
        wrote.append(sweep.frames)
        write(staging, sweep, table)

    monkeypatch.setattr(release, "_write_sweep", stops)
    out = tmp_path / "tree"
    with pytest.raises(KeyboardInterrupt):
        release.export(original, out)
    assert not out.exists()
    (part,) = tmp_path.glob(".tree.*.part")
    before = {path: path.stat().st_mtime_ns for path in part.rglob("*.png")}
    assert len(before) == sum(wrote)
    monkeypatch.undo()
    release.export(original, out)
    assert list(tmp_path.glob(".*")) == []
    for path, stamp in before.items():
        assert (out / path.relative_to(part)).stat().st_mtime_ns == stamp
    assert files(out) == files(tree)


def files(root: Path) -> dict[str, bytes]:
    found = (Path(base) / name for base, _, names in os.walk(root) for name in names)
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in found}
