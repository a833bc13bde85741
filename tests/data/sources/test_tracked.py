import os
import shutil
import zlib
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch

from racines_data import RacinesError, open_store
from racines_data.build.dataset import DataConfig, build
from racines_data.geometry import parameters_to_pose
from racines_data.sources.tracked.source import (
    TrackedSource,
    read_frames,
    read_header,
    square,
    upright,
)
from racines_data.validate.run import validate
from tests.data.pipes import fifo

REAL = Path(os.environ.get("RACINES_REAL", Path(__file__).parents[3] / ".." / "shared" / "real"))
SPINE, NWIRE = (REAL / f"{name}PhantomFreehand.igs.mha" for name in ("Spine", "Nwire"))
needs_real = pytest.mark.skipif(
    not (SPINE.is_file() and NWIRE.is_file()),
    reason=f"REAL SWEEPS ABSENT from {REAL}: set RACINES_REAL to their folder",
)

COUNT, WIDTH, HEIGHT = 10, 60, 40


def pose(index: int) -> np.ndarray:
    """Return the pose of a synthetic frame, mm: half a turn about x, moving along y."""
    matrix = np.diag([1.0, -1.0, -1.0, 1.0])
    matrix[:3, 3] = [-190.0, 10.0 * index, 1950.0]
    return matrix


def images() -> np.ndarray:
    rng = np.random.default_rng(0)
    return rng.integers(0, 256, (COUNT, HEIGHT, WIDTH), np.uint8)


def write_sequence(
    path: Path,
    changes: dict[str, str] | None = None,
    poses: dict[int, np.ndarray] | None = None,
    compressed: bool = True,
) -> Path:
    """Write a PLUS sequence; `changes` replaces header fields (None removes none)."""
    pixels = images().tobytes()
    content = zlib.compress(pixels) if compressed else pixels
    fields = {
        "ObjectType": "Image",
        "NDims": "3",
        "CompressedData": str(compressed),
        "DimSize": f"{WIDTH} {HEIGHT} {COUNT}",
        "ElementType": "MET_UCHAR",
        "UltrasoundImageOrientation": "MFA",
    }
    for index in range(COUNT):
        name = f"Seq_Frame{index:04d}_"
        numbers = (poses or {}).get(index, pose(index)).ravel()
        fields[f"{name}ProbeToTrackerTransform"] = " ".join(f"{x:g}" for x in numbers)
        fields[f"{name}ProbeToTrackerTransformStatus"] = "OK"
        fields[f"{name}StylusToTrackerTransform"] = "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"
        fields[f"{name}StylusToTrackerTransformStatus"] = "OK"
        fields[f"{name}Timestamp"] = f"{100 + 0.1 * index:.6f}"
        fields[f"{name}ImageStatus"] = "OK"
    fields |= changes or {}
    header = "".join(f"{key} = {value}\n" for key, value in fields.items())
    path.write_bytes(header.encode() + b"ElementDataFile = LOCAL\n" + content)
    return path


def test_no_fifo_is_waited_for_and_no_link_to_nothing_read(tmp_path: Path):
    with fifo(tmp_path / "a.igs.mha") as path, pytest.raises(RacinesError) as caught:
        source(path)
    told = f"{path}: a FIFO, a socket or a device, where a file is needed: name a .igs.mha file"
    assert str(caught.value) == told
    path.symlink_to(tmp_path / "absent.igs.mha")
    with pytest.raises(RacinesError, match=r"a\.igs\.mha: a link to nothing: name a"):
        source(path)
    with pytest.raises(RacinesError, match="a folder, where a file is needed: name a"):
        source(tmp_path)


def source(*paths: Path, **settings) -> TrackedSource:
    return TrackedSource.from_config(settings, paths)


def refusals(made: TrackedSource) -> list[tuple[str, str]]:
    return [(finding.item, finding.reason) for finding in made.report if finding.refused]


@pytest.mark.parametrize("compressed", [True, False])
def test_frames_and_poses(tmp_path: Path, compressed: bool):
    made = source(write_sequence(tmp_path / "a.igs.mha", compressed=compressed))
    units = made.plan()
    assert [unit.frames for unit in units] == [2] * 5 and made.report == []
    assert {unit.session for unit in units} == {"a"}
    trajectories = [made.produce(unit) for unit in units]
    got = np.concatenate([trajectory.images for trajectory in trajectories])
    assert np.array_equal(got, np.stack([square(image) for image in images()]))
    parameters = torch.from_numpy(np.concatenate([t.parameters for t in trajectories]))
    assert parameters[:, :6].isnan().all()
    position, rotation = parameters_to_pose(parameters)
    expected = torch.tensor([[-0.19, 0.01 * i, 1.95] for i in range(COUNT)])
    assert torch.allclose(position, expected)
    assert torch.allclose(rotation, torch.diag(torch.tensor([1.0, -1.0, -1.0])), atol=1e-6)
    assert np.allclose(
        np.concatenate([t.timestamps for t in trajectories]), 100 + np.arange(10) / 10
    )
    assert all((t.views == -1).all() and np.isnan(t.grades).all() for t in trajectories)


def test_another_transform_and_metres(tmp_path: Path):
    own = np.eye(4)
    own[:3, 3] = [0.1, 0.2, 0.3]
    text = " ".join(str(x) for x in own.ravel())
    changes = {f"Seq_Frame{i:04d}_ImageToReferenceTransform": text for i in range(COUNT)}
    path = write_sequence(tmp_path / "a.igs.mha", changes)
    made = source(path, transform="ImageToReference", unit="m")
    trajectory = made.produce(made.plan()[0])
    assert np.allclose(trajectory.parameters[0, 6:], [0.1, 0.2, 0.3, 0, 0, 0])
    with pytest.raises(RacinesError, match="no transform Probe; the file has ImageToReference"):
        build(source(path, transform="Probe"), tmp_path / "out")


@pytest.mark.parametrize(
    ("orientation", "rows", "columns"),
    [("MF", 1, 1), ("MFA", 1, 1), ("UFD", 1, -1), ("MN", -1, 1), ("UNA", -1, -1)],
)
def test_orientation(orientation: str, rows: int, columns: int):
    image = np.arange(6, dtype=np.uint8).reshape(2, 3)
    assert np.array_equal(upright(image, orientation), image[::rows, ::columns])


def test_orientation_of_other_images_is_refused(tmp_path: Path):
    path = write_sequence(tmp_path / "a.mha", {"UltrasoundImageOrientation": "FM"})
    with pytest.raises(RacinesError, match="UltrasoundImageOrientation FM: one of MF, UF, MN, UN"):
        build(source(path), tmp_path / "out")
    assert source(path, orientation="MF").plan()


def test_square_keeps_the_probe_at_the_top_centre():
    wide, tall = np.zeros((50, 100), np.uint8), np.zeros((100, 50), np.uint8)
    wide[0], tall[:, 25] = 255, 255
    assert square(wide)[0].min() > 100 and square(wide)[70:].max() == 0
    assert square(tall)[:, 62:66].max() > 100 and square(tall)[:, :30].max() == 0


def test_own_transform_invalid_is_refused_and_anothers_is_flagged(tmp_path: Path):
    changes = {
        "Seq_Frame0003_ProbeToTrackerTransformStatus": "INVALID",
        "Seq_Frame0005_StylusToTrackerTransformStatus": "INVALID",
        "Seq_Frame0006_StylusToTrackerTransformStatus": "INVALID",
    }
    made = source(write_sequence(tmp_path / "a.igs.mha", changes))
    assert sum(unit.frames for unit in made.plan()) == 9
    assert refusals(made) == [("frame 3", "ProbeToTrackerTransformStatus is INVALID")]
    (flag,) = [finding for finding in made.report if not finding.refused]
    assert flag.item == "StylusToTrackerTransformStatus" and flag.frames == 2
    build(made, tmp_path / "out", DataConfig(workers=1))
    rows = pq.read_table(tmp_path / "out" / "import_report.parquet").to_pylist()
    assert [row["refused"] for row in rows] == [True, False]
    with pytest.raises(RacinesError, match="strict.*frame 3: ProbeToTracker"):
        build(made, tmp_path / "strict", DataConfig(workers=1, strict=True))


def left_handed() -> np.ndarray:
    return pose(4) @ np.diag([1.0, 1.0, -1.0, 1.0])


def sheared() -> np.ndarray:
    matrix = pose(4)
    matrix[0, 1] = 0.1
    return matrix


@pytest.mark.parametrize(
    ("matrix", "reason"),
    [
        (pose(4) * np.nan, "is not finite"),
        (left_handed(), "is left-handed"),
        (sheared(), "is not a rigid pose"),
        (np.zeros((4, 3)), "is missing or not numbers"),
    ],
)
def test_bad_poses_are_refused(tmp_path: Path, matrix: np.ndarray, reason: str):
    made = source(write_sequence(tmp_path / "a.igs.mha", poses={4: matrix}))
    assert sum(unit.frames for unit in made.plan()) == 9
    ((item, said),) = refusals(made)
    assert item == "frame 4" and reason in said


def test_time_that_goes_back_is_refused(tmp_path: Path):
    changes = {"Seq_Frame0007_Timestamp": "1.0"}
    made = source(write_sequence(tmp_path / "a.igs.mha", changes))
    assert sum(unit.frames for unit in made.plan()) == 9
    assert refusals(made) == [("frame 7", "Timestamp 1.0 does not follow 100.6")]


def test_the_wrong_unit_is_refused_and_the_likely_one_named(tmp_path: Path):
    path = write_sequence(tmp_path / "a.igs.mha")
    with pytest.raises(RacinesError, match="1.96e.03 m when read in m; they are likely in mm"):
        build(source(path, unit="m"), tmp_path / "out")
    metres = {}
    for index in range(COUNT):
        metres[index] = pose(index)
        metres[index][:3, 3] /= 1000
    path = write_sequence(tmp_path / "b.igs.mha", poses=metres)
    with pytest.raises(RacinesError, match="when read in mm; they are likely in m: set unit to m"):
        build(source(path), tmp_path / "out")
    assert source(path, unit="m").plan()


@pytest.mark.parametrize("compressed", [True, False])
def test_a_truncated_file_is_refused(tmp_path: Path, compressed: bool):
    path = write_sequence(tmp_path / "a.igs.mha", compressed=compressed)
    path.write_bytes(path.read_bytes()[:-9000])
    with pytest.raises(RacinesError, match="10 of 10 frames refused.*truncated: [67] of"):
        build(source(path), tmp_path / "out", DataConfig(workers=1))


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        ({"ElementType": "MET_SHORT"}, "ElementType is MET_SHORT"),
        ({"DimSize": "60 40"}, "DimSize is missing or not three numbers"),
        ({"DimSize": "60 40 3"}, "does not fit"),
        ({"ObjectType": "Mesh"}, "ObjectType is Mesh"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, damage: dict[str, str], reason: str):
    with pytest.raises(RacinesError, match=reason):
        read_header(write_sequence(tmp_path / "a.mha", damage))


def test_what_is_no_sequence_is_refused(tmp_path: Path):
    path = tmp_path / "a.mha"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" * 100)
    with pytest.raises(RacinesError, match="not a PLUS sequence"):
        read_header(path)
    write_sequence(path).write_bytes(path.read_bytes()[:300])
    with pytest.raises(RacinesError, match="header is cut off"):
        read_header(path)


def test_damaged_packing_is_refused(tmp_path: Path):
    path = write_sequence(tmp_path / "a.mha")
    content = bytearray(path.read_bytes())
    content[-12000:-11900] = bytes(100)
    path.write_bytes(bytes(content))
    with pytest.raises(RacinesError, match="a.mha: (damaged image data|truncated)"):
        list(read_frames(read_header(path)))


def test_inputs_and_settings_are_checked(tmp_path: Path):
    path = write_sequence(tmp_path / "a.igs.mha")
    (tmp_path / "b").mkdir()
    shutil.copy(path, tmp_path / "b" / "a.mha")
    with pytest.raises(RacinesError, match="name its files: --input"):
        source()
    with pytest.raises(RacinesError, match="no.mha: no such file"):
        source(tmp_path / "no.mha")
    with pytest.raises(RacinesError, match="two inputs have one name"):
        source(path, tmp_path / "b" / "a.mha")
    with pytest.raises(RacinesError, match="data.tracked.unit 'cm'"):
        source(path, unit="cm")
    with pytest.raises(RacinesError, match="data.tracked.untis: unknown key"):
        source(path, untis="mm")


@pytest.mark.usefixtures("warm_workers")
def test_order_of_inputs_and_workers_do_not_matter(tmp_path: Path):
    paths = [write_sequence(tmp_path / f"{name}.igs.mha") for name in "ab"]
    one = build(source(*paths), tmp_path / "one", DataConfig(workers=1))
    two = build(source(*paths[::-1]), tmp_path / "two", DataConfig(workers=2))
    assert one["digest"] == two["digest"] and one["recipe_digest"] == two["recipe_digest"]
    assert one["held_out_session"] == "b"


@needs_real
@pytest.mark.parametrize(
    ("path", "frames", "flagged", "first"),
    [
        (SPINE, 21, 0, [0.172641, -0.0980022, -0.0220262]),
        (NWIRE, 97, 1, [-0.190886, -0.0980911, -1.94907]),
    ],
)
def test_real_sweeps(tmp_path: Path, path: Path, frames: int, flagged: int, first: list[float]):
    root = tmp_path / "racines"
    manifest = build(source(path), root, DataConfig(workers=1))
    assert manifest["counts"]["frames"] == frames
    assert manifest["report"] == {"refused_frames": 0, "flagged": flagged}
    result = validate(root)
    assert result.ok, result.checks
    store = open_store(root)
    start = store.parameters[store.timestamps.argmin()]
    assert torch.allclose(start[6:9], torch.tensor(first))
    assert all(len(store.split_indices(split)) for split in ("train", "validation", "test"))
    assert (store.images.flatten(1).max(1).values > 100).all()
    card = (root / "README.md").read_text()
    assert "tracked freehand" in card and "neighbours in time" in card


@needs_real
def test_both_real_sweeps_make_two_sessions(tmp_path: Path):
    manifest = build(source(SPINE, NWIRE), tmp_path / "racines", DataConfig(workers=1))
    assert manifest["counts"]["sessions"] == {
        "NwirePhantomFreehand": 97,
        "SpinePhantomFreehand": 21,
    }
    assert set(manifest["configs"]) == {"frames", "trajectories", "sessions"}
