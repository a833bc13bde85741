"""The source `table`: every kind of pose, clock and image gives the same sweep."""

import json
import sys
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy.spatial.transform import Rotation as Turn

from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.schema import Trajectory
from racines_data.sources.images import square
from racines_data.sources.table.mapping import check_mapping
from racines_data.sources.tracked.source import TrackedSource, read_header
from tests.data.sources.table_folder import (
    COUNT,
    EULER,
    HEIGHT,
    MATRICES,
    MATRIX,
    QUATERNION,
    QUATERNIONS,
    ROBOT,
    WIDTH,
    changed,
    check,
    columns_of,
    source,
    sweep,
    synthetic,
    synthetic_folder,
    write_recording,
)
from tests.data.sources.test_tracked import NWIRE, SPINE, needs_real


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return synthetic_folder(tmp_path_factory.mktemp("mine"))


@pytest.fixture(scope="module")
def expected(folder: Path) -> Trajectory:
    return sweep(folder, ROBOT)


def test_poses_are_those_of_the_columns(expected: Trajectory):
    poses, times, images = synthetic()
    assert np.allclose(expected.parameters[:, 6:9], poses[:, :3, 3] / 1000, atol=1e-6)
    angles = Turn.from_matrix(poses[:, :3, :3]).as_euler("xyz")
    assert np.allclose(expected.parameters[:, 9:], angles, atol=1e-6)
    assert np.array_equal(expected.timestamps, times)
    assert np.array_equal(expected.images, np.stack([square(image) for image in images]))
    assert np.isnan(expected.parameters[:, :6]).all() and (expected.views == -1).all()


POSES = {
    "matrix of 16": MATRICES["poses"],
    "matrix of 12": changed(MATRICES, poses__rotation__columns=MATRIX[:12])["poses"],
    "matrix of 9": changed(
        ROBOT,
        poses__rotation={"kind": "matrix", "columns": [m for m in MATRIX[:12] if m[2] != "3"]},
    )["poses"],
    "euler": changed(ROBOT, poses__rotation=EULER)["poses"],
    "w last": changed(
        ROBOT, poses__rotation__columns=[*QUATERNION[1:], "qw"], poses__rotation__order="xyzw"
    )["poses"],
}


@pytest.mark.parametrize("kind", POSES)
def test_every_kind_of_rotation(folder: Path, expected: Trajectory, kind: str):
    check(sweep(folder, {**ROBOT, "poses": POSES[kind]}), expected)


def _own_columns(turns: Turn, poses: np.ndarray, times: np.ndarray) -> dict[str, tuple]:
    """Return columns and changes of the mapping by name."""
    vector = dict(zip(("vx_", "vy_", "vz_"), np.degrees(turns.as_rotvec()).T, strict=True))
    named = {"kind": "vector", "columns": [*vector], "unit": "deg"}
    yaw = dict(zip(("a1", "a2", "a3"), turns.as_euler("ZYX", degrees=True).T, strict=True))
    by_axes = {"kind": "euler", "columns": [*yaw], "order": "ZYX", "unit": "deg"}
    stamps = pl.Series(times * 1e9).cast(pl.Int64)
    iso = stamps.cast(pl.Datetime("ns")).dt.strftime("%Y-%m-%dT%H:%M:%S%.9f")
    back = np.linalg.inv(poses).reshape(-1, 16)
    backward = dict(zip((f"b{i}" for i in range(16)), back.T, strict=True))
    given = {"kind": "matrix", "columns": [*backward], "unit": "mm"}
    inverse = {"poses__position": None, "poses__rotation": given, "poses__invert": True}
    return {
        "vector": (vector, {"poses__rotation": named}),
        "intrinsic angles in degrees": (yaw, {"poses__rotation": by_axes}),
        "nanoseconds": ({"stamp": stamps}, {"poses__time": {"column": "stamp", "unit": "ns"}}),
        "iso": ({"when": iso}, {"poses__time": {"column": "when", "unit": "iso"}}),
        "rate": ({}, {"poses__time": {"rate": 25.0, "start": 100.0}}),
        "inverted": (backward, inverse),
    }


def test_other_columns(tmp_path: Path, expected: Trajectory):
    poses, times, _ = synthetic()
    ways = _own_columns(Turn.from_matrix(poses[:, :3, :3]), poses, times)
    columns = {name: each for way, _ in ways.values() for name, each in way.items()}
    folder = synthetic_folder(tmp_path, **columns)
    for changes in (changes for _, changes in ways.values()):
        check(sweep(folder, changed(ROBOT, **changes)), expected)


def _write(folder: Path, table: pl.DataFrame, ending: str) -> None:
    path = folder / f"poses{ending}"
    if ending == ".parquet":
        table.write_parquet(path)
    elif ending == ".jsonl":
        table.write_ndjson(path)
    elif ending == ".json":
        path.write_text(json.dumps({"log": {"rows": table.to_dicts()}}))
    elif ending == ".bom.csv":
        path.write_bytes(b"\xef\xbb\xbf" + table.write_csv().encode())
    elif ending == ".utf16.csv":
        path.write_bytes(table.write_csv().encode("utf-16"))
    else:
        path.write_text(table.write_csv(separator=";", decimal_comma=True))


@pytest.mark.parametrize(
    "ending", [".parquet", ".json", ".jsonl", ".bom.csv", ".utf16.csv", ".comma.csv"]
)
def test_every_kind_of_table(folder: Path, expected: Trajectory, ending: str):
    _write(folder, pl.read_csv(folder / "poses.csv"), ending)
    changes = {"poses__file": f"poses{ending}"}
    if ending == ".json":
        changes["poses__records"] = "log.rows"
    if ending == ".comma.csv":
        with pytest.raises(RacinesError, match=r"column '\w+' has decimal commas.*decimal_comma"):
            sweep(folder, changed(ROBOT, **changes))
        changes["poses__decimal_comma"] = True
    check(sweep(folder, changed(ROBOT, **changes)), expected)


def test_lists_in_cells_and_nested_records(tmp_path: Path, expected: Trajectory):
    poses, times, images = synthetic()
    synthetic_folder(tmp_path)
    rows = [
        {"pose": {"matrix": pose.tolist()}, "t": float(t), "image": f"frames/{i}.png"}
        for i, (pose, t) in enumerate(zip(poses, times, strict=True))
    ]
    (tmp_path / "log.json").write_text(json.dumps(rows))
    rotation = {"kind": "matrix", "columns": ["pose.matrix"], "unit": "mm"}
    own = {"poses__position": None, "poses__rotation": rotation, "poses__file": "log.json"}
    check(sweep(tmp_path, changed(ROBOT, **own)), expected)


def test_clocks_are_matched(tmp_path: Path):
    """Poses at 100 Hz, images at 25 Hz on another clock, 3 s behind."""
    at = np.linspace(0, 1, 101)
    turns = Turn.from_euler("xyz", np.stack([3 + 0.3 * at, 0.1 * at, 0.2 * at], -1))
    poses = np.tile(np.eye(4), (101, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = turns.as_matrix(), np.outer(at, [40, 20, 5]) + [450, 0, 80]
    pl.DataFrame(columns_of(poses, 100 + at)).write_csv(tmp_path / "poses.csv")
    images = np.random.default_rng(1).integers(0, 256, (20, HEIGHT, WIDTH), np.uint8)
    np.save(tmp_path / "scan.npy", images)
    times = 97 + 0.003 + 0.04 * np.arange(20)
    pl.DataFrame({"ms": times * 1e3}).write_csv(tmp_path / "clock.csv")
    clock = {"file": "clock.csv", "time": {"column": "ms", "unit": "ms"}}
    mapping = changed(
        ROBOT, images={"path": "scan.npy", "clock": clock}, match={"max_gap": 0.011, "offset": 3.0}
    )
    made = sweep(tmp_path, mapping)
    share = (times - 97)[:, None]
    assert np.allclose(made.timestamps, times) and len(made) == 20
    assert np.allclose(
        made.parameters[:, 6:9], (share * [40, 20, 5] + [450, 0, 80]) / 1e3, atol=1e-6
    )
    exact = Turn.from_euler("xyz", np.concatenate([3 + 0.3 * share, 0.1 * share, 0.2 * share], 1))
    found = Turn.from_euler("xyz", made.parameters[:, 9:])
    assert (exact.inv() * found).magnitude().max() < 1e-5
    nearest = sweep(tmp_path, changed(mapping, match__how="nearest"))
    assert np.allclose(nearest.parameters[:, 6], (450 + 40 * np.round(share[:, 0], 2)) / 1e3)
    with pytest.raises(RacinesError, match=r"no image lies within.*match.offset is 2\.99"):
        source(tmp_path, changed(mapping, match__offset=0.0)).plan()
    with pytest.raises(RacinesError, match="rows are 0.01 s apart: raise max_gap"):
        source(tmp_path, changed(mapping, match__max_gap=0.005)).plan()
    late = source(tmp_path, changed(mapping, match__offset=3.5))
    assert sum(unit.frames for unit in late.plan()) == 13 and len(late.report) == 7
    assert "beyond match.max_gap" in late.report[0].reason


def test_calibration_and_positions_alone(tmp_path: Path):
    poses, times, images = synthetic()
    hold = np.eye(4)
    hold[:3, :3], hold[:3, 3] = Turn.from_euler("x", 180, degrees=True).as_matrix(), [0, 0, 10]
    folder = synthetic_folder(tmp_path)
    alone = changed(ROBOT, poses__rotation={"kind": "none"})
    with pytest.raises(RacinesError, match="calibration.probe_to_tracker has to say how"):
        source(folder, alone)
    held = sweep(folder, changed(alone, calibration__probe_to_tracker=hold.tolist()))
    assert np.allclose(held.parameters[:, 6:9] * 1e3, poses[:, :3, 3] + [0, 0, 10], atol=1e-3)
    assert np.allclose(np.abs(held.parameters[:, 9]), np.pi, atol=1e-6)
    image = np.eye(4)
    image[:3, :3] = 0.2 * Turn.from_euler("z", 90, degrees=True).as_matrix()
    image[:3, 3] = [1, 2, 3]
    base = np.eye(4)
    base[:3, 3] = [0, 0, 20]
    calibration = {"image_to_probe": image.tolist(), "tracker_to_base": base.tolist()}
    made = sweep(folder, changed(ROBOT, calibration={**calibration, "image_scaled": True}))
    image[:3, :3] /= 0.2
    exact = base @ poses @ image
    assert np.allclose(made.parameters[:, 6:9] * 1e3, exact[:, :3, 3], atol=1e-3)
    turned = Turn.from_matrix(exact[:, :3, :3]).as_euler("xyz")
    assert np.allclose(made.parameters[:, 9:], turned, atol=1e-5)


def test_labels_forces_controls_sessions(tmp_path: Path):
    names = [f"{kind}{axis}" for kind in "fm" for axis in "xyz"]
    wrench = np.random.default_rng(2).normal(size=(COUNT, 6))
    columns = dict(zip(names, wrench.T, strict=True))
    columns |= dict(zip([f"u{i}" for i in range(6)], np.zeros((6, COUNT)), strict=True))
    columns |= {"view": ["four", ""] * (COUNT // 2), "grade": [7.0, None] * (COUNT // 2)}
    columns |= {"who": ["anna"] * COUNT, "goal": ["SC"] * COUNT}
    columns |= {"part": ["a"] * 8 + ["b/2"] * (COUNT - 8)}
    folder = synthetic_folder(tmp_path, **columns)
    labels = {"view": "view", "grade": "grade", "session": "who", "target_view": "goal"}
    mapping = changed(
        ROBOT,
        labels={**labels, "names": {"four": "A4C"}},
        forces={"columns": names, "torque_unit": "N·mm"},
        controls={"columns": [f"u{i}" for i in range(6)]},
        poses__sweep="part",
    )
    made = source(folder, mapping)
    units = made.plan()
    assert [(u.id, u.session, u.target_view, u.frames) for u in units] == [
        ("a", "anna", "SC", 8), ("b-2", "anna", "SC", COUNT - 8),
    ]  # fmt: skip
    first = made.produce(units[0])
    assert np.allclose(first.parameters[:, :3], wrench[:8, :3])
    assert np.allclose(first.parameters[:, 3:6], wrench[:8, 3:] / 1e3)
    assert (first.views == [0, -1] * 4).all() and (first.controls == 0).all()
    assert np.allclose(first.grades[::2], 7) and np.isnan(first.grades[1::2]).all()
    with pytest.raises(RacinesError, match="'four' is none of A4C"):
        source(folder, changed(mapping, labels__names={})).plan()
    own = source(folder, changed(mapping, labels__views=["four", "SC"], labels__names={}))
    assert own.labels == ("four", "SC", "Random") and own.plan()


def test_a_dataset_and_its_card(folder: Path, tmp_path: Path):
    mapping = changed(ROBOT, segments=5)
    config = DataConfig(source="table", workers=1, licence="CC-BY-4.0", consent="Nobody scanned.")
    manifest = build(source(folder, mapping), tmp_path / "a", config)
    assert manifest["counts"]["frames"] == COUNT and manifest["card"]["license"] == "cc-by-4.0"
    card = (tmp_path / "a" / "README.md").read_text()
    assert "license: cc-by-4.0" in card and "as declared at import: Nobody scanned" in card
    again = build(source(folder, mapping), tmp_path / "b", DataConfig(source="table", workers=1))
    assert (
        again["digest"] == manifest["digest"]
        and again["recipe_digest"] == manifest["recipe_digest"]
    )
    card = (tmp_path / "b" / "README.md").read_text()
    assert "license: unknown" in card and "The licence of these frames is unknown" in card


@needs_real
@pytest.mark.parametrize("path", [SPINE, NWIRE])
def test_both_sources_read_the_same_poses(tmp_path: Path, path: Path):
    """To 1e-6 m and 1e-6 rad, and the same gray levels, by matrices and by quaternions.

    The file's matrices have six digits and are rotations to a millionth only. Both sources take the
    nearest rotation, of which the quaternions are made as well.
    """
    tracked = TrackedSource.from_config({}, [path])
    wanted = [tracked.produce(unit) for unit in tracked.plan()]
    write_recording(tmp_path, read_header(path))
    table = source(tmp_path, MATRICES)
    made = [table.produce(unit) for unit in table.plan()]
    assert [len(each) for each in made] == [len(each) for each in wanted]
    for one, other in zip(made, wanted, strict=True):
        check(one, other)
    table = source(tmp_path, QUATERNIONS)
    for unit, other in zip(table.plan(), wanted, strict=True):
        one = table.produce(unit)
        assert np.array_equal(one.parameters[:, 6:9], other.parameters[:, 6:9])
        turned = (Turn.from_euler("xyz", each.parameters[:, 9:]) for each in (one, other))
        assert (next(turned).inv() * next(turned)).magnitude().max() < 1e-6


def test_without_the_extra_the_remedy_is_told(folder: Path, monkeypatch: pytest.MonkeyPatch):
    for module, ending in (("av", ".mp4"), ("pydicom", ".dcm")):
        monkeypatch.setitem(sys.modules, module, None)
        (folder / f"no{ending}").write_bytes(b"0" * 200)
        with pytest.raises(RacinesError, match=rf'needs {module}: pip install "racines\[import\]"'):
            source(folder, changed(ROBOT, images__path=f"no{ending}")).plan()


def test_a_mapping_is_checked_key_by_key():
    for changes, told in (
        ({"poses__rotation__order": "wzyx"}, "poses.rotation.order: 'wzyx': expected"),
        ({"poses__rotation__kind": "quat"}, "poses.rotation"),
        ({"poses__position__unit": "inch"}, "poses.position.unit: 'inch'"),
        ({"poses__position__columns": ["x", "y"]}, "2 columns, where 1 or 3 are needed"),
        ({"poses__places": 1}, "poses.places: unknown key"),
        ({"poses__time": {"unit": "s"}}, "poses.time: give a column, or a rate"),
        ({"images": {}}, "images.path: needed, and left out"),
        ({"images__crop": [1, 2, 3]}, "images.crop"),
        ({"segments": 0}, "segments"),
        ({"frame": "world"}, "frame: 'world'"),
    ):
        with pytest.raises(RacinesError) as caught:
            check_mapping(changed(ROBOT, **changes), "m.yaml")
        assert told in str(caught.value) and str(caught.value).startswith("m.yaml: "), caught.value
