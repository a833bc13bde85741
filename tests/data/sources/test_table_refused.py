"""Bad folders for the source `table`: one clear error each, and nothing half-written."""

import os
import struct
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from PIL import Image

from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.sources.table import TableSource
from racines_data.sources.table.inputs import open_folder
from tests.data.pipes import fifo
from tests.data.sources.table_folder import (
    COUNT,
    ROBOT,
    changed,
    columns_of,
    synthetic,
    synthetic_folder,
    write_mapping,
)
from tests.data.sources.test_table_images import write_images


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return synthetic_folder(tmp_path / "mine")


def refusal(folder: Path, mapping: dict, **config) -> str:
    """Return why an import stops; nothing is left beside the folder."""
    write_mapping(folder, mapping)
    settings = DataConfig(source="table", workers=1, **config)
    with pytest.raises(RacinesError) as caught:
        build(TableSource.from_config({}, [folder]), folder.parent / "out", settings)
    assert {path.name for path in folder.parent.iterdir()} - {"mine", "aside"} == set()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def rewrite(folder: Path, **columns) -> None:
    table = pl.read_csv(folder / "poses.csv").with_columns(**columns)
    table.write_csv(folder / "poses.csv")


def test_a_mirrored_rotation(folder: Path):
    poses, times, _ = synthetic()
    mirrored = poses @ np.diag([1.0, -1.0, 1.0, 1.0])
    columns = dict(zip([f"n{i}" for i in range(16)], mirrored.reshape(-1, 16).T, strict=True))
    rewrite(folder, **{name: pl.Series(each) for name, each in columns.items()})
    rotation = {"kind": "matrix", "columns": [*columns], "unit": "mm"}
    told = refusal(folder, changed(ROBOT, poses__position=None, poses__rotation=rotation))
    assert "poses.rotation: mirrored" in told and "left-handed" in told


def test_mixed_sizes(folder: Path):
    for row in range(8):
        Image.new("L", (20, 30), 90).save(folder / f"frames/{row}.png")
    told = refusal(folder, ROBOT)
    assert "8 of 24 frames refused" in told and "frames/0.png" in told and "mixed sizes" in told


def test_missing_frames(folder: Path):
    (folder / "frames/3.png").unlink()
    told = refusal(folder, ROBOT, strict=True)
    assert "row 3: missing image: frames/3.png: no such file" in told
    made = TableSource.from_config({}, [folder])
    assert sum(unit.frames for unit in made.plan()) == COUNT - 1 and len(made.report) == 1
    told = refusal(folder, changed(ROBOT, images__path="frames/*.png"))
    assert "missing frames: 23 images for 24 rows" in told


def test_truncated_image(folder: Path):
    path = folder / "frames/3.png"
    path.write_bytes(path.read_bytes()[:-40])
    assert "frames/3.png image 3: truncated PNG" in refusal(folder, ROBOT, strict=True)


def test_times_that_do_not_run_on(folder: Path):
    times = 100 + 0.04 * np.arange(COUNT)
    times[5] = 90.0
    rewrite(folder, t=pl.Series(times))
    assert "row 5: clock: 90.000000 s does not go on" in refusal(folder, ROBOT, strict=True)
    rewrite(folder, t=pl.Series(times[::-1]))
    assert "poses.time.column: backwards" in refusal(folder, ROBOT)


@pytest.mark.parametrize(("at", "value"), [("x", None), ("qw", "INVALID"), ("t", None)])
def test_what_is_no_number(folder: Path, at: str, value: str | None):
    texts = pl.read_csv(folder / "poses.csv")[at].cast(pl.String).to_list()
    rewrite(folder, **{at: pl.Series([*texts[:2], value, *texts[3:]])})
    told = refusal(folder, ROBOT, strict=True)
    expected = "row 2: NaN" if value is None else "column 'qw', row 2: 'INVALID' is no number"
    assert expected in told


def test_links_out_fifos_folders_and_names_that_lead_out(folder: Path):
    aside = folder.parent / "aside"
    aside.mkdir()
    (folder / "frames/0.png").rename(aside / "0.png")
    place = folder / "frames/0.png"
    place.symlink_to(aside / "0.png")
    assert "images.path: frames/0.png: a link out of the folder" in refusal(folder, ROBOT)
    place.unlink()
    os.mkfifo(place)
    assert "images.path: frames/0.png: a FIFO" in refusal(folder, ROBOT)
    place.unlink()
    place.mkdir()
    assert "frames/0.png: a folder, where a file is needed" in refusal(folder, ROBOT)
    place.rmdir()
    place.symlink_to("nowhere")
    assert "frames/0.png: a link to nothing" in refusal(folder, ROBOT)
    for path in ("/etc/passwd", "../aside/0.png", "a/../../aside/0.png"):
        assert "leads out of" in refusal(folder, changed(ROBOT, images__path=path))
        assert "leads out of" in refusal(folder, changed(ROBOT, poses__file=path))
    assert "inside the folder" in refusal(folder, changed(ROBOT, images__path="../aside/*.png"))
    for path in ("{image.__class__}", "{image!r}", "{image", "{row:>999999999}"):
        assert "images.path" in refusal(folder, changed(ROBOT, images__path=path))
    os.mkfifo(folder / "pipe.csv")
    assert "poses.file: pipe.csv: a FIFO" in refusal(folder, changed(ROBOT, poses__file="pipe.csv"))
    assert folder / "pipe.csv" not in open_folder(folder).walk()


def test_headers_that_claim_what_no_memory_holds(folder: Path):
    header = {"descr": "|u1", "fortran_order": False, "shape": (COUNT, 40_000, 42_000)}
    with (folder / "scan.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
    told = refusal(folder, changed(ROBOT, images__path="scan.npy"))
    assert "scan.npy: not a whole array of numbers" in told
    with (folder / "scan.npy").open("r+b") as file:
        file.truncate(128 + COUNT * 40_000 * 42_000)  # sparse: 40 GB that take no room
    told = refusal(folder, changed(ROBOT, images__path="scan.npy"))
    assert "scan.npy: its header says 24 images of 42000×40000: an image has at most" in told
    (folder / "scan.mha").write_text(
        "ObjectType = Image\nNDims = 3\nDimSize = 40000 42000 24\nElementType = MET_UCHAR\n"
        "ElementDataFile = LOCAL\n"
    )
    told = refusal(folder, changed(ROBOT, images__path="scan.mha"))
    assert "scan.mha: DimSize 40000 42000 24: more than 64,000,000 pixels" in told


def test_a_video_of_forty_gigabytes(folder: Path):
    """By the header of a real AVI alone: its frames hold 48×64 pixels, and none can be decoded."""
    write_images(folder, np.zeros((COUNT, 48, 64), np.uint8), ".avi")
    claim_size(folder / "scan.avi", 8000, 5000, 1000)
    told = refusal(folder, changed(ROBOT, images__path="scan.avi"))
    assert "scan.avi: its header says 1000 images of 8000×5000, 40 GB once decoded" in told
    assert "at most 32; damaged, or cut it into sweeps of their own files" in told
    claim_size(folder / "scan.avi", 8000, 5000, COUNT + 1)
    told = refusal(folder, changed(ROBOT, images__path="scan.avi"))
    assert f"scan.avi: truncated: {COUNT} of {COUNT + 1} frames are there" in told


def claim_size(path: Path, width: int, height: int, count: int) -> None:
    """Let an AVI's header claim images of another size and number; its data stay as they are."""
    content = bytearray(path.read_bytes())
    # A chunk is its name, its length, and fields of four bytes; see Microsoft's AVI RIFF reference.
    main, stream, shape = (content.index(name) + 8 for name in (b"avih", b"strh", b"strf"))
    struct.pack_into("<II", content, main + 32, width, height)
    struct.pack_into("<II", content, shape + 4, width, height)
    struct.pack_into("<I", content, main + 16, count)
    struct.pack_into("<I", content, stream + 32, count)
    path.write_bytes(content)


@pytest.mark.parametrize("ending", [".mp4", ".avi", ".npy", ".dcm", ".mha"])
def test_what_is_no_such_file(folder: Path, ending: str):
    (folder / f"scan{ending}").write_bytes(b"\x00\x01no" * 300)
    told = refusal(folder, changed(ROBOT, images__path=f"scan{ending}"))
    assert f"scan{ending}: " in told


def test_tables_that_are_none(folder: Path):
    (folder / "bad.parquet").write_bytes(b"PAR1" + b"\0" * 100)
    (folder / "bad.json").write_text("{")
    (folder / "bad.csv").write_bytes(b"t,x\n1,2\n1,5,2\n")
    (folder / "latin.csv").write_bytes("t,größe\n1,2\n".encode("latin-1"))
    (folder / "none.csv").write_text("t,x\n")
    for name, told in (
        ("bad.parquet", "cannot be read as a table"),
        ("bad.json", "cannot be read as a table"),
        ("bad.csv", "decimal commas in a table whose columns are parted by commas"),
        ("latin.csv", "save it as UTF-8"),
        ("none.csv", "a table without rows"),
        ("poses.xlsx", "no such file"),
        ("frames/0.png", "not a table that is read here"),
    ):
        assert told in refusal(folder, changed(ROBOT, poses__file=name)), name
    assert "no column 'qq'; it has t, x" in refusal(
        folder, changed(ROBOT, poses__rotation__columns=["qq", "qx", "qy", "qz"])
    )


def test_a_mapping_that_is_a_fifo_or_a_link_to_nothing(folder: Path):
    with fifo(folder / "mapping.yaml") as path, pytest.raises(RacinesError) as caught:
        TableSource.from_config({}, [folder])
    remedy = "racines data map FOLDER --guess writes a mapping"
    told = f"{path}: a FIFO, a socket or a device, where a file is needed: {remedy}"
    assert str(caught.value) == told
    path.symlink_to("nowhere")
    with pytest.raises(RacinesError, match=rf"mapping\.yaml: a link to nothing: {remedy}"):
        TableSource.from_config({}, [folder])


def test_floats_and_sixteen_bits_are_refused(folder: Path):
    np.save(folder / "scan.npy", np.zeros((COUNT, 48, 64), np.float32))
    told = refusal(folder, changed(ROBOT, images__path="scan.npy"))
    assert "float32: likely 0-1 or 16 bits" in told
    np.save(folder / "scan.npy", np.array([{}] * COUNT), allow_pickle=True)
    assert "not a whole array" in refusal(folder, changed(ROBOT, images__path="scan.npy"))


def test_frozen_images_and_poses(folder: Path):
    rewrite(folder, image=pl.lit("frames/0.png"))
    assert "frozen" in refusal(folder, ROBOT)
    one = {
        name: pl.lit(each[0]) for name, each in columns_of(*synthetic()[:2]).items() if name != "t"
    }
    rewrite(folder, image=pl.Series([f"frames/{i}.png" for i in range(COUNT)]), **one)
    assert "frozen poses" in refusal(folder, ROBOT)


def test_two_sweeps_of_one_name(folder: Path):
    rewrite(folder, part=pl.Series(["a b"] * 12 + ["a/b"] * 12))
    told = refusal(folder, changed(ROBOT, poses__sweep="part"))
    assert "two sweeps are called 'a-b'" in told
